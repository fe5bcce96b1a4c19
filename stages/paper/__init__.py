"""Statistics of the paper's experiments: means of a sweep, and the choice of parameters."""
