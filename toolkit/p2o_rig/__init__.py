"""Consistent extrinsics of all sensors of a body: a pose graph of results, aligned sweeps and known transforms."""
