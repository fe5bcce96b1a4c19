"""What a dataset holds: scan files, pairs, and what is wrong with them."""
