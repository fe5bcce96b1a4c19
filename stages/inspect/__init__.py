"""Inspecting scans: sensors, beam patterns, frames, sequences and time stamps."""
