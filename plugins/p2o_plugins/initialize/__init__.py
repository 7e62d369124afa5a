"""Initializers, one file a method."""
