"""`p2o fleet`: check the extrinsics of many vehicles, and report on them."""

from __future__ import annotations

import importlib.util
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import plugin_options
from p2o.cli.progress import LINE_INTERVAL_S
from p2o.errors import MethodUnavailable, printable
from p2o_study.cli.ablate import cluster_options, jobs_option

if TYPE_CHECKING:
    from p2o_fleet.evidence import Evidence
    from p2o_fleet.run import RunOutcome


@click.group("fleet")
def command() -> None:
    """Check the extrinsics of many vehicles, find slips and systematic errors, and report on them.

    `p2o fleet run` checks the drives of a table and stores the evidence, `p2o fleet report` applies sequential tests
    to it and writes JSON and a page. docs/how-to/fleet.md explains table, store and tests.
    """
    if importlib.util.find_spec("pyarrow") is None:
        hint = 'run: pip install "p2o-calib[fleet]"'
        raise MethodUnavailable("p2o fleet needs the package pyarrow, which is not installed", hint=hint)


_option = partial(click.option, show_default=True)
_store = _option("--store", default="p2o-out/fleet", metavar="DIR", help="Folder of the stored evidence.")
_COUNT, _SEED = click.IntRange(1, 1_000_000), click.IntRange(0)
_SHARE, _DEG = click.FloatRange(0, 1), click.FloatRange(-90, 90)


@command.command("run")
@click.argument("drives")
@_store
@jobs_option
@cluster_options
@_option("--frames", default=8, metavar="N", help="Number of frames of a check.")
@_option("--candidates", default=12, metavar="N", help="Number of frames, spread in time, to choose from.")
@_option("--extractor", default="p2ornet/rings", metavar="IMAGE/CLOUD", help="The two extractors.")
@click.option("--set", "options", multiple=True, metavar="STAGE.FIELD=VALUE", help="An option of a method.")
@json_option
@click.option("--quiet", is_flag=True, help="No progress.")
@plugin_options
def run(
    drives: str,
    store: str,
    jobs: int,
    backend: Any,
    address: str | None,
    options: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
    **words: Any,
) -> int:
    """Check the drives of a table that are not stored yet.

    DRIVES is a CSV file with the columns vehicle, camera, lidar, data, extrinsic and time. A log that cannot be read is
    stored with the reason, and tried again by the next run.

    \b
    p2o fleet run drives.csv --store fleet --jobs 4
    p2o fleet run drives.csv --store fleet --backend dask --address tcp://HOST:8786

    Exit status 0 if every drive is checked, 1 if logs were unreadable, 2 for wrong input, 130 if interrupted.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.run.words import parse_settings
    from p2o_study.parallel import Workers
    from p2o_study.worker import Plugins

    from p2o_fleet.drive import drives_of
    from p2o_fleet.evidence import Verdict
    from p2o_fleet.run import run_fleet
    from p2o_fleet.store import Store
    from p2o_fleet.worker import CheckSettings

    settings = CheckSettings(**words, options=json.dumps(parse_settings(options), sort_keys=True))
    done = run_fleet(
        drives_of(drives),
        Store(Path(store).expanduser()),
        settings=settings,
        plugins=Plugins.of(block, plugin),
        workers=Workers(jobs, backend, address),
        on_check=(lambda outcome, evidence: None) if quiet or as_json else _show_progress(),
    )
    unreadable = done.verdicts[Verdict.UNREADABLE.value]
    for text in done.damaged:
        click.echo(printable(f"p2o: skipped: {text}"), err=True)
    if as_json:
        counts = {verdict.value: done.verdicts[verdict.value] for verdict in Verdict}
        damaged = {"damaged": list(done.damaged)} if done.damaged else {}
        print_json({"checked": done.checked, "kept": done.kept, "seconds": done.seconds, **counts, **damaged})
    else:
        parts = ", ".join(f"{count} {verdict}" for verdict, count in sorted(done.verdicts.items()))
        click.echo(f"{done.checked} drives checked{f' ({parts})' if parts else ''}, {done.kept} stored before; {store}")
    if done.interrupted:
        click.echo("p2o: interrupted: the same command continues", err=True)
        return 130
    return 1 if unreadable else 0


def _show_progress() -> Callable[[RunOutcome, Evidence], None]:
    """Return a function that prints a line of progress every few seconds, and a line for each unreadable log."""
    last = time.monotonic()

    def show(outcome: RunOutcome, evidence: Evidence) -> None:
        nonlocal last
        if evidence.verdict == "unreadable":
            print(f"p2o: {printable(evidence.drive.data, 200)}: {printable(evidence.reason)}", file=sys.stderr)
        if time.monotonic() - last > LINE_INTERVAL_S:
            last = time.monotonic()
            print(f"p2o: {outcome.checked} drives checked, {outcome.kept} stored before", file=sys.stderr)

    return show


@command.command("report")
@_store
@_option("--out", default="p2o-out/fleet-report", metavar="DIR", help="Folder of the report.")
@_option("--rate", default=0.01, metavar="SHARE", help="False discovery rate of the alarms.")
@_option("--tolerance", default="0.2deg 3cm", metavar="SIZE", help="Constant error that counts as correct.")
@_option("--type-tolerance", default="0.03deg 1cm", metavar="SIZE", help="The same for the mean of a vehicle type.")
@_option("--notice", default="0.5deg 5cm", metavar="SIZE", help="Error that has to be detectable.")
@jobs_option
@click.option("--require", is_flag=True, help="Exit status 1 also if the state of an extrinsic is unknown.")
@json_option
def report(store: str, out: str, jobs: int, require: bool, as_json: bool, **rules: Any) -> int:
    """Compute the state of every extrinsic from the stored evidence, and write the report.

    Writes index.html (a page that works offline) and fleet.json to DIR.

    \b
    p2o fleet report --store fleet --out report
    p2o fleet report --store fleet --rate 0.001 --json

    Exit status 0 without alarms, 1 with an alarm of a vehicle or a type (with --require also if the state of an
    extrinsic is unknown), 2 for wrong input.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o_study.parallel import Workers

    from p2o_fleet.fleet_state import FleetRules, FleetStatus, fleet_state
    from p2o_fleet.outputs import summary_lines, write_state
    from p2o_fleet.page import write_page
    from p2o_fleet.store import Store

    state = fleet_state(Store.existing(store), FleetRules(**rules), Workers(jobs))
    folder = Path(out).expanduser()
    plain = write_state(state, folder)
    write_page(state, folder)
    if as_json:
        print_json(plain)
    else:
        click.echo("\n".join(printable(line) for line in summary_lines(state)))
        click.echo(f"wrote {folder / 'index.html'} and fleet.json")
    unknown = any(one.status is FleetStatus.CANNOT_TELL for one in state.current)
    return 1 if state.alarms or any(one.alarms for one in state.types) or (require and unknown) else 0


@command.command("simulate")
@click.argument("out")
@_option("--vehicles", type=_COUNT, default=1000, metavar="N", help="Number of vehicles.")
@_option("--checks", type=_COUNT, default=100, metavar="N", help="Number of checks of each vehicle.")
@_option("--faults", type=_SHARE, default=0.1, metavar="SHARE", help="Share of vehicles with a fault.")
@_option("--wrong-cad", type=_DEG, default=0.0, metavar="DEG", help="Yaw error of all vehicles of one type.")
@_option("--seed", type=_SEED, default=0, metavar="N", help="Seed of all random numbers.")
def simulate(out: str, vehicles: int, checks: int, faults: float, wrong_cad: float, seed: int) -> int:
    """Write the store of a simulated fleet: measured evidence of real and simulated rigs, resampled, with faults.

    Half of the faults are slips; the others are drifts, swapped cameras, dirty lenses, broken logs and clock errors.

    \b
    p2o fleet simulate fleet --vehicles 1000 --faults 0.1
    p2o fleet report --store fleet --out report
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.errors import InputError

    from p2o_fleet.simulation import Fault, NoiseBank, Scenario, simulated_fleet, write_fleet
    from p2o_fleet.store import Store

    others = (Fault.DRIFT, Fault.SWAPPED, Fault.DIRTY, Fault.BROKEN, Fault.CLOCK)
    shares = {Fault.SLIP: faults / 2, **dict.fromkeys(others, faults / 2 / len(others))}
    store = Store(Path(out).expanduser())
    if store.checks_folder.exists():
        raise InputError("the folder contains a store", where=out, expected="a new folder")
    scenario = Scenario(vehicles, checks, shares=shares, wrong_cad_deg=wrong_cad, seed=seed)
    total = write_fleet(simulated_fleet(scenario, NoiseBank.shipped()), store)
    click.echo(f"{total} checks of {vehicles} vehicles written to {out}")
    return 0
