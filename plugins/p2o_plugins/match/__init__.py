"""Matchers, one file a method."""
