"""The version of the algorithm, which keys of stored results and features contain."""

from __future__ import annotations

ALGORITHM = 3
"""Raised by hand when a change of p2o, without its plugins, alters poses or verdicts: stored results become stale."""
