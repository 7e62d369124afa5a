"""Commands of the calibration file formats."""
