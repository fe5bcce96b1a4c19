"""Finished runs: open, measure, compare and check them."""
