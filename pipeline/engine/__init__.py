"""How keyed tasks run: keys, order, memory, pools, workers, progress."""
