"""`p2o check`: does an extrinsic that is in use still hold?"""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import click

from p2o.cli.plugin_options import load, plugin_options
from p2o.errors import printable

if TYPE_CHECKING:
    from p2o.results.check import AxisCheck, Check, Slip, Watch


@click.command("check")
@click.argument("data", metavar="DATASET:PATH")
@click.option(
    "--extrinsic", required=True, metavar="FILE|truth|start", help="The extrinsic: a file, or the one that data hold."
)
@click.option("--frames", metavar="SPEC", help="Which frames, as in `p2o run`; all are taken together (default: all).")
@click.option("--notice", metavar='"0.3deg 3cm"', help='Errors that have to be noticed (default: "1deg 30cm").')
@click.option(
    "--alarm-rate", type=float, default=0.01, show_default=True, metavar="SHARE", help="Right ones called off."
)
@click.option(
    "--power", type=float, default=0.95, show_default=True, metavar="SHARE", help="Errors at a limit noticed."
)
@click.option("--require", is_flag=True, help="Exit status 1 where it cannot be told, too.")
@click.option("--watch", "watching", is_flag=True, help="Frame after frame over a drive: when did it slip?")
@click.option("--alarms-per-hour", type=float, metavar="N", help="With --watch: false alarms an hour (default: 0.1).")
@click.option("--rate", "rate_hz", type=float, metavar="HZ", help="With --watch: frames a second (default: as told).")
@click.option(
    "--settle",
    type=click.IntRange(min=1),
    metavar="N",
    help="With --watch: first frames, which are usual (default: 20).",
)
@click.option("--extractor", metavar="IMAGE/CLOUD", help="The two extractors (default: p2ornet/rings).")
@click.option("--matcher", metavar="NAME", help="How points and lines are paired (default: ogm).")
@click.option("--set", "settings", multiple=True, metavar="STAGE.FIELD=VALUE", help="An option.")
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Seed of everything random (default: 0).")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object and nothing else on stdout.")
@plugin_options
def command(
    data: str,
    extrinsic: str,
    frames: str | None,
    notice: str | None,
    alarm_rate: float,
    power: float,
    require: bool,
    watching: bool,
    alarms_per_hour: float | None,
    rate_hz: float | None,
    settle: int | None,
    extractor: str | None,
    matcher: str | None,
    settings: tuple[str, ...],
    seed: int | None,
    as_json: bool,
    plugin: tuple[str, ...],
    block: tuple[str, ...],
) -> int:
    """Say whether an extrinsic still holds, axis by axis: holds, off by about so much, or nobody can tell.

    \b
    p2o check kitti-raw:PATH --extrinsic truth --frames 0-9
    p2o check folder:PATH --extrinsic result.json --notice "0.3deg 3cm" --require
    p2o check folder:DRIVE --extrinsic calib.yaml --watch

    Nothing is moved. Every axis has the smallest error that would have been noticed on these frames. Exit status 0
    where no axis is off, 1 where any is (with --require also where it cannot be told), 2 for wrong input.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    import contextlib

    from p2o.results.check import Holding
    from p2o.results.result_json import check_to_dict
    from p2o.run.check import Words, check, watch

    _check_words(watching, notice, {"--alarms-per-hour": alarms_per_hour, "--rate": rate_hz, "--settle": settle})
    stdout = sys.stdout
    with contextlib.redirect_stdout(sys.stderr) if as_json else contextlib.nullcontext():
        words: Words = {
            "frames": frames,
            "extractor": extractor,
            "matcher": matcher,
            "options": settings or None,
            "seed": seed,
            "registry": load(plugin, block),
        }
        found: Check | Watch
        if watching:
            found = watch(
                data,
                extrinsic,
                **words,
                alarms_per_hour=0.1 if alarms_per_hour is None else alarms_per_hour,
                rate_hz=rate_hz,
                settle=20 if settle is None else settle,
            )
        else:
            found = check(
                data,
                extrinsic,
                **words,
                notice=notice,
                alarm_rate=alarm_rate,
                power=power,
            )
    if as_json:
        stdout.write(json.dumps(check_to_dict(found), indent=1, allow_nan=False, ensure_ascii=False) + "\n")
    else:
        stdout.write(describe_check(found) + "\n")
    bad = {Holding.OFF, Holding.CANNOT_TELL} if require else {Holding.OFF}
    return 1 if found.holding in bad else 0


def _check_words(watching: bool, notice: str | None, of_watch: dict[str, float | None]) -> None:
    """Raise InputError for words that the other way to look at frames has."""
    from p2o.errors import InputError

    said = [word for word, value in of_watch.items() if value is not None]
    if said and not watching:
        raise InputError(f"{said[0]} is for a drive", expected="--watch beside it")
    if watching and notice is not None:
        raise InputError("--notice is for frames together", expected="--alarms-per-hour with --watch")
    for word, value in of_watch.items():
        if value is not None and not 0 < value < float("inf"):
            raise InputError(f"{word} is out of bounds", expected="more than zero", got=value)


def describe_check(found: Check | Watch) -> str:
    """Return the readable account of a check or a watch."""
    from p2o.results.check import Check

    lines = _of_check(found) if isinstance(found, Check) else _of_watch(found)
    return "\n".join(printable(line) for line in lines)


def _of_check(found: Check) -> list[str]:
    many = f"{len(found.frames)} frames" if len(found.frames) > 1 else found.frames[0]
    lines = [many, f"  {_word(found.holding):<12} {found.reason}"]
    if found.found is not None:
        lines.append(f"  {'axis':<12} {'':<12} {'off by':>10}  {'+-':>8}  {'noticed from':>12}")
        lines += [_axis(axis) for axis in found.axes]
        lines.append(
            f"  {'in all':<12} a right one is as far off in {100 * (found.p_value or 0):.2g} % of cases; "
            f"limits: {100 * found.power:g} % noticed, {100 * found.alarm_rate:g} % false alarms"
        )
    if found.agreement is not None:
        met = found.agreement
        lines.append(f"  {'agreement':<12} odds ratio {met.odds_ratio:.1f} in {met.places} places: {met.strength:.1f}")
    return [*lines, *(f"  {'warning':<12} {text}" for text in found.warnings)]


def _axis(axis: AxisCheck) -> str:
    assert axis.off is not None
    assert axis.sigma is not None
    assert axis.limit is not None
    scale, unit, digits = (1, "deg", 3) if axis.unit == "deg" else (100, "cm", 1)
    off, sigma, limit = (scale * value for value in (axis.off, axis.sigma, axis.limit))
    return (
        f"    {axis.axis:<10} {_word(axis.holding):<12} {off:>+10.{digits}f}  {sigma:>8.{digits}f}  "
        f"{limit:>12.{digits}f} {unit}"
    )


def _of_watch(found: Watch) -> list[str]:
    lines = [f"{len(found.frames)} frames, one after the other", f"  {_word(found.holding):<12} {found.reason}"]
    lines += [f"  {'slip':<12} {_slip(slip)}" for slip in found.slips]
    told = [frame for frame in found.frames if frame.level is not None]
    if told:
        highest = max(told, key=lambda frame: frame.level or 0.0)
        lines.append(f"  {'charts':<12} at most {highest.level:.2f} of an alarm, {highest.axis} at {highest.name}")
    lines.append(
        f"  {'alarms':<12} {found.alarms_per_hour:g} false ones an hour are meant, at {found.rate_hz:g} frames a "
        f"second (correlation {found.correlation:.2f}); the first {found.settled} frames say what is usual"
    )
    return [*lines, *(f"  {'warning':<12} {text}" for text in found.warnings)]


def _slip(slip: Slip) -> str:
    size, sigma = (
        (f"{slip.size:+.2f}", f"{slip.sigma:.2f} deg")
        if slip.unit == "deg"
        else (f"{100 * slip.size:+.1f}", f"{100 * slip.sigma:.1f} cm")
    )
    return (
        f"{slip.axis} {size} +- {sigma}: noticed at frame {slip.noticed} ({slip.noticed_frame}), began about "
        f"{slip.began} ({slip.began_frame})"
    )


def _word(holding: str) -> str:
    return holding.replace("-", " ")
