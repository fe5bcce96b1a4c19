"""Scans and finished runs as files of other formats: `fidpipe convert` and `fidpipe export`."""
