"""Explaining the difference between a simulated and a real scan."""
