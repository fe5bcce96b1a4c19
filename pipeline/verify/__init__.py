"""Verifying a finished run: every number computed again by the literal twin of the method."""
