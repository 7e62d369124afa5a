"""`p2o plugin check`: run the conformance checks."""

from __future__ import annotations

import os
import traceback
from collections import Counter
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import click
from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import P2OError, UnknownNameError, one_line, printable

if TYPE_CHECKING:
    from p2o.host.registry import Offer, Registry

    from p2o_testing import Case


class Outcome(StrEnum):
    """The printed outcome of a check of a method."""

    PASSED = "ok"
    FAILED = "FAIL"
    EXPECTED = "known"
    NOT_APPLICABLE = "n/a"


@click.command("check")
@click.argument("name")
@click.option("--set", "settings", multiple=True, metavar="STAGE.FIELD=VALUE", help="An option of the method.")
@plugin_options
def command(name: str, settings: tuple[str, ...], plugin: tuple[str, ...], block: tuple[str, ...]) -> int:
    """Check that methods fulfil the contracts of their slots.

    NAME is a plugin (distribution, entry point, or a file given with --plugin), or one method. The checks depend on
    `needs` and `gives` of a method; checks that do not apply are n/a, with the reason. The path of a dataset is set by
    --set data.root=PATH. Exit status 1 if a check fails.
    """
    from p2o.host.slots import SLOT_OF
    from p2o.run.words import parse_settings

    from p2o_testing import checks_for, reads_files

    options = parse_settings(settings)
    registry = load(plugin, block)
    outcomes: Counter[Outcome] = Counter()
    for offer in _meant(registry, name):
        own_options = options.get(SLOT_OF[offer.kind].stage, {})
        if reads_files(offer) and "root" not in own_options:
            click.echo(f"skip  {offer.kind} {offer.name}: set data.root to check it")
            continue
        for case in checks_for(offer, options=own_options, registry=registry):
            outcomes[_ran(case)] += 1
    failed, apart = outcomes[Outcome.FAILED], outcomes[Outcome.NOT_APPLICABLE]
    summary = f"{failed} checks failed" if failed else "every check passed"
    click.echo(summary + (f", {apart} not applicable" if apart else ""))
    return 1 if failed else 0


def _ran(case: Case) -> Outcome:
    """Run one check, print and return its outcome."""
    from p2o_testing import NotApplicable

    offer, reason = case.subject.offer, case.expected_failure
    title = f"{offer.kind} {offer.name}: {case.check.name}"
    try:
        case()
    except NotApplicable as problem:
        click.echo(f"{Outcome.NOT_APPLICABLE:<5} {title}\n      not applicable: {problem}")
        return Outcome.NOT_APPLICABLE
    except KeyboardInterrupt:
        raise
    except BaseException as problem:
        if reason:
            click.echo(f"{Outcome.EXPECTED:<5} {title} ({reason})")
            return Outcome.EXPECTED
        own = isinstance(problem, P2OError | AssertionError)
        text = printable(problem if own else f"{type(problem).__name__}: {one_line(problem)}")
        click.echo(f"{Outcome.FAILED:<5} {title}\n      promised: {case.check.promise}\n      but: {text}")
        if os.environ.get("P2O_DEBUG", "") not in ("", "0"):
            click.echo(traceback.format_exc())
        return Outcome.FAILED
    if reason:
        click.echo(f"{Outcome.FAILED:<5} {title}\n      passes, although it is in expected_failures: {reason}")
        return Outcome.FAILED
    click.echo(f"{Outcome.PASSED:<5} {title}")
    return Outcome.PASSED


def _meant(registry: Registry, name: str) -> tuple[Offer, ...]:
    """Return the methods of the plugin `name`, else the methods of this name."""
    offers = tuple(o for o in registry.offers if name in (o.dist, o.entry, f"{o.dist}:{o.entry}"))
    if offers:
        return offers
    try:
        return registry.named(name)
    except UnknownNameError as problem:
        plugins = {o.dist for o in registry.offers}
        hint = problem.advice
        if name.endswith(".py"):
            hint = f"load a file with --plugin: p2o plugin check {Path(name).stem} --plugin {name}"
        raise UnknownNameError("plugin or method", name, {*plugins, *problem.known}, hint=hint) from None
