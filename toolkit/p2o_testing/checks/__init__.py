"""The conformance checks: what a method of each slot promises, one small function a promise, one module a slot."""

from __future__ import annotations

from p2o_testing.checks import calibrators, datasets, edges, every_method, exporters, extractors, matchers, solvers
from p2o_testing.subject import Check

CHECKS: list[Check] = [*every_method.CHECKS, *every_method.OF_FRAMES, *extractors.CHECKS, *edges.CHECKS]
CHECKS += [*matchers.CHECKS, *solvers.CHECKS, *matchers.INITIALIZERS, *calibrators.CHECKS, *datasets.ACCUMULATORS]
CHECKS += [*datasets.CHECKS, *exporters.CHECKS, *exporters.READERS]
"""Every check, slot by slot."""
