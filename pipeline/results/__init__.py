"""Finished runs: opened, measured, compared, judged."""
