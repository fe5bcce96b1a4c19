"""Ray casting, and what it is tried on: made streets and their flawed twins, recordings, perturbed scans, flaws."""
