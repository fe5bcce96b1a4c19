"""The experiments of the paper: perturbation and ablation."""
