"""Solid bodies of known size: balls, boxes and their corners, in images and in sweeps."""
