"""Calibration files: their content, their bytes, and what a reader of a format provides."""
