"""Statistics of the paper's experiments: means of a perturbation sweep, and the choice of parameters."""
