"""Reproducing the paper: perturbation and ablation experiments, its claims and its tables."""
