"""Verification of a finished run: recompute its numbers by the literal twin of the method."""
