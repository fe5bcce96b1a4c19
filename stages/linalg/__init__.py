"""Linear algebra of graphs: subgraphs, Laplacians, spectra, heat kernels, assignment. Imports no stage."""
