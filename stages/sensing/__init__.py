"""What sensors see and how scans are altered: ray casting and perturbations."""
