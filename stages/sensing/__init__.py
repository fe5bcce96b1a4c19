"""Ray casting, and what it is tried on: made streets, their flawed twins, perturbed scans."""
