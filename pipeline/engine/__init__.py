"""Execution of keyed tasks: keys, order, memory, pools, workers, progress."""
