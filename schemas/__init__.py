"""Tables, metrics, settings, results and errors. Imports no other package of fidpipe."""
