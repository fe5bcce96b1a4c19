"""Ray casting and perturbations."""
