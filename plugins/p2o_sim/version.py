"""The version of the simulator, by which its frames are identified."""

VERSION = 1
"""Raised by hand when the same options give other frames: stored results on frames of the simulator become stale."""
