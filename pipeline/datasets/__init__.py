"""Datasets: scan files, pairs, and their problems."""
