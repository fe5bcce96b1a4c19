"""Finished runs as files of other formats: `fidpipe export`."""
