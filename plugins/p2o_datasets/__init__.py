"""Data sets of other authors, one module per data set, and readers of their file formats."""
