"""Generating datasets: synthetic streets, twins of recorded scans, best cases."""
