"""Offers every method of this package; each lives in the file of its name."""
