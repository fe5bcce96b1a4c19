"""Scheduling, storage, workers and the command line: everything around the stages."""
