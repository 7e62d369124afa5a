"""Readers and exporters of calibration files of other systems, one module per family of formats."""
