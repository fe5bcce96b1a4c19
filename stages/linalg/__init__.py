"""Linear algebra of graphs: Laplacians, spectra, assignment."""
