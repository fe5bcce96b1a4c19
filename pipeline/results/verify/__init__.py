"""Some numbers of a finished run made again, another way, and compared: what `fidpipe verify` does."""
