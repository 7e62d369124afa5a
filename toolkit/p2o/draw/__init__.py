"""Overlays and plots of results."""
