"""Accumulators: sweeps of a sequence as one dense cloud."""
