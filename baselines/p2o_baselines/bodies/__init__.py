"""Solid bodies of known size: balls, boxes and their corners, in pictures and in sweeps."""
