"""The conformance checks: what a method of each slot promises, one small function a promise, one module a slot."""

from __future__ import annotations

from p2o.testing.check import Check as Check
from p2o.testing.checks import (
    accumulators,
    calibrators,
    cloud_edges,
    datasets,
    every_method,
    exporters,
    extractors,
    image_edges,
    initializers,
    matchers,
    solvers,
)
from p2o.testing.subject import CheckFailed as CheckFailed
from p2o.testing.subject import NotApplicable as NotApplicable
from p2o.testing.subject import Subject as Subject

CHECKS: list[Check] = [
    *every_method.CHECKS,
    *every_method.OF_FRAMES,
    *extractors.CHECKS,
    *image_edges.CHECKS,
    *extractors.OF_CLOUDS,
    *cloud_edges.CHECKS,
    *matchers.CHECKS,
    *solvers.CHECKS,
    *initializers.CHECKS,
    *calibrators.CHECKS,
    *accumulators.CHECKS,
    *datasets.CHECKS,
    *exporters.CHECKS,
]
"""Every check, slot by slot."""
