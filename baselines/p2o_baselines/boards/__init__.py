"""Boards as targets: detection in image and sweep, assignment, and least squares."""
