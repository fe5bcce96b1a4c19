"""The statistics of the paper: its claims, sweeps and choice of parameters."""
