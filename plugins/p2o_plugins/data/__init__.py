"""Datasets, one file a layout."""
