"""`p2o doctor`: does this installation do its job, and what is missing."""

from __future__ import annotations

import json
from dataclasses import asdict

import click

_FAILED = 1


@click.command("doctor")
@click.option("--json", "as_json", is_flag=True, help="One JSON object instead of lines: ok and findings.")
@click.option("--quick", is_flag=True, help="Leave out the calibration of a small synthetic street, some seconds.")
def command(as_json: bool, quick: bool) -> int:
    """Look whether this installation can do its job, and say what is missing and how to get it.

    Python, machine, packages, extras, GPU, cache folder, plugins, weights, and a calibration with a known answer.
    Exit status 0 where the main job works, 1 where it does not; extras that are absent are no failure.
    """
    from p2o.cli.checkup import Finding, State, findings
    from p2o.errors import one_line

    seen: list[Finding] = []
    for finding in findings(self_check=not quick):
        seen.append(finding)
        if not as_json:
            click.echo(f"{finding.state:<7}" + one_line(f"{finding.group} {finding.name}: {finding.detail}"))
            if finding.advice:
                click.echo(f"{'':7}{finding.advice}")
    bad = [finding for finding in seen if finding.state is State.BAD]
    if as_json:
        click.echo(json.dumps({"ok": not bad, "findings": [asdict(each) for each in seen]}, indent=2))
    else:
        names = ", ".join(f"{each.group} {each.name}" for each in bad)
        click.echo(f"\nit does not work: {names}" if bad else "\neverything that the main job needs works")
    return _FAILED if bad else 0
