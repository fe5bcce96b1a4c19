"""Inspecting datasets: scans, frames, sides and sensors, as `fidpipe check` shows them."""
