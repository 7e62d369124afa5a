"""`p2o check`: check whether an extrinsic in use is still valid."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from p2o.cli.json_output import json_option, print_json
from p2o.cli.plugin_options import (
    data_argument,
    extractor_option,
    load,
    matcher_option,
    plugin_options,
    seed_option,
    settings_option,
    text_option,
)
from p2o.cli.progress import long_work, status_line
from p2o.errors import InputError, printable

if TYPE_CHECKING:
    from p2o.results.check import AxisCheck, Check, Slip, Watch


@click.command("check")
@data_argument("The data.")
@text_option("--extrinsic", "FILE|truth|start", "The extrinsic: a file, or that of the data.", required=True)
@text_option("--frames", "SPEC", "Which frames, as in `p2o run`; they are evaluated jointly (default: all).")
@text_option("--notice", '"0.3deg 3cm"', 'Errors that have to be detectable (default: "1deg 30cm").')
@text_option("--alarm-rate", "SHARE", "False-alarm rate.", type=float, default=0.01, show_default=True)
@text_option(
    "--power", "SHARE", "Detection rate of an error at the limit.", type=float, default=0.95, show_default=True
)
@click.option("--require", is_flag=True, help="Exit status 1 also if the outcome is cannot-tell.")
@click.option("--watch", "watching", is_flag=True, help="Check each frame of a drive and detect slips of the mounting.")
@text_option("--alarms-per-hour", "N", "With --watch: false alarms per hour (default: 0.1).", type=float)
@click.option(
    "--rate",
    "rate_hz",
    type=float,
    metavar="HZ",
    help="With --watch: frames per second (default: from the times of the frames).",
)
@text_option(
    "--settle",
    "N",
    "With --watch: number of first frames that define the normal level (default: 20).",
    type=click.IntRange(min=1),
)
@extractor_option
@matcher_option
@settings_option()
@seed_option
@text_option("--out", "DIR", "Folder of a page (check.html) and its JSON (check.json).", type=click.Path())
@json_option
@plugin_options
def command(
    data: str,
    extrinsic: str,
    watching: bool,
    require: bool,
    out: str | None,
    as_json: bool,
    settings: tuple[str, ...],
    plugin: tuple[str, ...],
    block: tuple[str, ...],
    **words: Any,
) -> int:
    """Check whether an extrinsic is valid, by axis: holds, off (with an estimate of the error), or cannot tell.

    \b
    p2o check kitti-raw:PATH --extrinsic truth --frames 0-9
    p2o check folder:PATH --extrinsic result.json --notice "0.3deg 3cm" --require
    p2o check folder:DRIVE --extrinsic calib.yaml --watch

    The extrinsic is not changed. The output states for each axis the smallest error that is detectable on these frames.
    Exit status 0 if no axis is off, 1 if any is (with --require also for cannot-tell), 2 for wrong input.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.cli.out_dir import OutDir
    from p2o.files.whole_file import write_json, write_whole
    from p2o.page.check_page import JSON, PAGE, check_page
    from p2o.results.check import CheckStatus
    from p2o.results.result_json import to_dict
    from p2o.run.check import check, watch

    of_watch = {name: words.pop(name) for name in ("alarms_per_hour", "rate_hz", "settle")}
    _check_words(watching, words["notice"], of_watch)
    folder = None if out is None else OutDir.prepared(out).root
    with status_line("checking", quiet=as_json) as show, long_work(show) as work:
        work("checking the extrinsic")
        words |= {"options": settings or None, "registry": load(plugin, block)}
        check_result: Check | Watch
        if watching:
            words = {name: value for name, value in words.items() if name not in ("notice", "alarm_rate", "power")}
            words |= {name: value for name, value in of_watch.items() if value is not None}
            check_result = watch(data, extrinsic, **words)
        else:
            check_result = check(data, extrinsic, **words)
    if folder is not None:
        write_json(folder / JSON, to_dict(check_result))
        write_whole(folder / PAGE, check_page(check_result, describe_check(check_result)).encode())
    if as_json:
        print_json(to_dict(check_result))
    else:
        click.echo(describe_check(check_result))
    bad = {CheckStatus.OFF, CheckStatus.CANNOT_TELL} if require else {CheckStatus.OFF}
    return 1 if check_result.holding in bad else 0


def _check_words(watching: bool, notice: str | None, of_watch: dict[str, float | None]) -> None:
    """Raise InputError for options that do not apply with or without --watch, and for values out of bounds."""
    given = {
        f"--{name.removesuffix('_hz').replace('_', '-')}": value
        for name, value in of_watch.items()
        if value is not None
    }
    if given and not watching:
        raise InputError(f"{next(iter(given))} needs --watch", expected="--watch")
    if watching and notice is not None:
        raise InputError("--notice does not apply with --watch", expected="--alarms-per-hour")
    for word, value in given.items():
        if not 0 < value < float("inf"):
            raise InputError(f"{word} is out of bounds", expected="more than zero", got=value)


def describe_check(check_result: Check | Watch) -> str:
    """Return the text about a check or a watch."""
    from p2o.results.check import Check

    lines = _of_check(check_result) if isinstance(check_result, Check) else _of_watch(check_result)
    return "\n".join(printable(line) for line in lines)


def percent(probability: float) -> str:
    """Return a probability in percent with two digits, without an exponent from 0.01 % on."""
    value = 100 * probability
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def _of_check(check: Check) -> list[str]:
    many = f"{len(check.frames)} frames" if len(check.frames) > 1 else check.frames[0]
    lines = [many, f"  {_word(check.holding):<12} {check.reason}"]
    if check.estimate is not None:
        lines.append(f"  {'axis':<12} {'':<12} {'error':>10}  {'+-':>8}  {'detectable':>12}")
        lines += [_axis(axis) for axis in check.axes]
        lines.append(
            f"  {'all axes':<12} a correct extrinsic deviates this much or more with a probability of "
            f"{percent(check.p_value or 0)} %; limits: {100 * check.power:g} % detected, "
            f"{100 * check.alarm_rate:g} % false alarms"
        )
    if check.agreement is not None:
        agreement = check.agreement
        cells = f"{agreement.places} independent cells"
        text = f"odds ratio {agreement.odds_ratio:.1f}, {cells}, evidence {agreement.strength:.1f}"
        lines.append(f"  {'agreement':<12} {text}")
    return [*lines, *(f"  {'warning':<12} {text}" for text in check.warnings)]


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


def _of_watch(watch: Watch) -> list[str]:
    lines = [f"{len(watch.frames)} frames, checked separately", f"  {_word(watch.holding):<12} {watch.reason}"]
    lines += [f"  {'slip':<12} {_slip(slip)}" for slip in watch.slips]
    lines.append(f"  {'detectable':<12} {_detectable(watch)}")
    observed = [frame for frame in watch.frames if frame.level is not None]
    if observed:
        highest = max(observed, key=lambda frame: frame.level or 0.0)
        lines.append(f"  {'charts':<12} at most {highest.level:.2f} of an alarm, {highest.axis} at {highest.name}")
    lines.append(
        f"  {'alarms':<12} {watch.alarms_per_hour:g} false alarms per hour expected, at {watch.rate_hz:g} frames per "
        f"second (correlation {watch.correlation:.2f}); the first {watch.settled} frames define the normal level"
    )
    return [*lines, *(f"  {'warning':<12} {text}" for text in watch.warnings)]


def _detectable(watch: Watch) -> str:
    """Return the smallest detectable slip of each axis."""
    from p2o.results.check import size_text

    after = f"slips after the first {watch.settled} of {len(watch.frames)} frames"
    sizes = [f"{one.axis} {size_text(one.unit, one.size)}" for one in watch.detectable if one.size is not None]
    return f"{after} from about {', '.join(sizes)}" if sizes else f"no {after}: take more frames"


def _slip(slip: Slip) -> str:
    from p2o.results.check import size_text

    size = size_text(slip.unit, slip.size, "+").partition(" ")[0]
    places = f"detected at frame {slip.noticed} ({slip.noticed_frame}), began at about frame {slip.began}"
    return f"{slip.axis} {size} +- {size_text(slip.unit, slip.sigma)}: {places} ({slip.began_frame})"


def _word(holding: str) -> str:
    return holding.replace("-", " ")
