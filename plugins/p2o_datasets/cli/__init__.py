"""Commands of the data sets package."""
