"""Generating datasets: synthetic streets, twins of recorded scans, noise floors."""
