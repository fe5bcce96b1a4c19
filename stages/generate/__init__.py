"""Generating scans: scenes, ray casting, re-scanning recorded surfaces, flaws of a simulator."""
