"""`fidpipe diagnose`: explaining the difference between real and simulated scans of a run."""
