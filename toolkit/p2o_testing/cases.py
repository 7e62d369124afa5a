"""Checks of a method as cases, which tests of plugins and `p2o plugin check` run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from p2o.errors import MethodUnavailable, UnknownNameError
from p2o.host.method import Kind, Method
from p2o.host.registry import Offer, Registry
from p2o.options import validated

from p2o_testing.checks import CHECKS
from p2o_testing.subject import Check, NotApplicable, Subject


@dataclass(frozen=True)
class Case:
    """One check of one method; call it, and it raises CheckFailed (or a P2OError) if the promise is broken.

    It raises NotApplicable, which pytest counts as skipped, where there is nothing to check the method on, or a package
    that it needs is not installed. `expected_failure` is the reason why the method is known to break it, or empty.
    """

    check: Check
    subject: Subject
    expected_failure: str = ""

    @property
    def name(self) -> str:
        """A name such as solver-lm-solutions_repeat."""
        offer = self.subject.offer
        return f"{offer.kind.value.replace(' ', '-')}-{offer.name}-{self.check.name}"

    def __call__(self) -> None:
        try:
            self.check.function(self.subject)
        except MethodUnavailable as problem:
            raise NotApplicable(str(problem)) from problem


def checks_for(
    method: Offer | Method,
    kind: Kind | None = None,
    options: Mapping[str, Any] | None = None,
    registry: Registry | None = None,
) -> list[Case]:
    """Return every check that is for a method, by its kind and by what it needs and gives.

    `kind` is needed for a bare Method, `options` for a dataset that reads files; `registry` (default: installed
    methods) holds the methods that may serve it. Raises TypeError where the kind is missing, UnknownNameError for
    expected failures of checks that do not exist, and InputError for bad options.
    """
    if isinstance(method, Method):
        if kind is None:
            raise TypeError("a bare Method does not know its kind: checks_for(method, Kind.SOLVER)")
        method = Offer(kind, method, "under-test", "", "plugin")
    known = {check.name for check in CHECKS}
    reasons = dict(method.method.expected_failures)
    for name in reasons.keys() - known:
        raise UnknownNameError("conformance check", name, known, where=f"expected_failures of {method.name}")
    subject = Subject(method, validated(method.method.options, options or {}, method.name), registry)
    meant = [check for check in CHECKS if check.is_for(method.kind, method.method)]
    return [Case(check, subject, reasons.get(check.name, "")) for check in meant]


def conformance_cases(plugin: str | Registry | Sequence[Offer], options: Mapping[str, Any] | None = None) -> list[Any]:
    """Return a pytest parameter for every check of every method of a plugin, a registry or a list of offers.

    `plugin` is the name of an installed distribution. Expected failures are strict: a check that passes after all is
    reported. `options` maps method names to options; datasets that read files are left out without their `root`.
    """
    import pytest

    offers: Sequence[Offer]
    registry: Registry | None = plugin if isinstance(plugin, Registry) else None
    if isinstance(plugin, str):
        registry = Registry.load()
        offers = [offer for offer in registry.offers if plugin in (offer.dist, offer.entry)]
        if not offers:
            raise UnknownNameError("plugin", plugin, {offer.dist for offer in registry.offers})
    else:
        offers = plugin.offers if isinstance(plugin, Registry) else plugin
    values = options or {}
    cases = [
        case
        for offer in offers
        if offer.name in values or not reads_files(offer)
        for case in checks_for(offer, options=values.get(offer.name), registry=registry)
    ]
    marks = [[pytest.mark.xfail(reason=c.expected_failure, strict=True)] if c.expected_failure else [] for c in cases]
    return [pytest.param(case, id=case.name, marks=mark) for case, mark in zip(cases, marks, strict=True)]


def reads_files(offer: Offer) -> bool:
    """Return whether a dataset reads a folder of files, whose path the check requires."""
    return offer.kind == Kind.DATASET and "root" in offer.method.options.model_fields
