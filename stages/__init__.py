"""The method: pure functions on arrays. No files, no dask, no clock, no global state. Read `method` first."""
