"""Calibration files of other systems: cameras and extrinsics, read and written; one module a family of files."""
