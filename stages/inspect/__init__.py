"""Inspecting the scans of a side as a sequence."""
