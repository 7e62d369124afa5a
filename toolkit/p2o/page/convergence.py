"""The plot of one result by round: matches by direction, residual and cost."""

from __future__ import annotations

import math
from collections.abc import Sequence

from p2o.draw.overlay import COLOURS
from p2o.errors import printable
from p2o.features.side import SIDES
from p2o.page.plot import Axis, Figure, Panel, Series
from p2o.results.figures import result_name, status_text
from p2o.results.result import DIRECTED, Result, Round

_PIXELS = "pixels"


def convergence(result: Result) -> Figure:
    """Return matches, residual and cost by round, as in the convergence figure of the paper.

    Matches are stacked by direction; rejected rounds are hollow. A cost in another unit than pixels has a separate
    panel, and residuals are left out if no round has any.
    """
    rounds = result.rounds
    numbers = range(1, len(rounds) + 1)
    x = Axis("round" if all(r.accepted for r in rounds) else "round (hollow: rejected)", whole=True)
    counts = {side.letter: [r.matches.get(side.letter, 0) for r in rounds] for side in SIDES}
    rest = [
        sum(r.matches.values()) - sum(some) for r, some in zip(rounds, zip(*counts.values(), strict=True), strict=True)
    ]
    colours = {letter: "#" + bytes(COLOURS[letter]).hex() for letter in counts}
    bars = [
        Series(name, numbers, some, "bars", colour=colours.get(name, "#bbbbbb"))
        for name, some in {**counts, "no direction": rest}.items()
        if any(some)
    ]
    name, unit = _cost(result)
    residuals = [r.mean_residual for r in rounds]
    residual = [_line("mean residual", rounds, residuals)] if not rounds or any(map(math.isfinite, residuals)) else []
    cost = _line(name, rounds, [r.cost for r in rounds])
    panels = [Panel(x, Axis("matches", zero=True), bars)]
    if unit == _PIXELS or not residual:
        panels.append(Panel(x, Axis(unit, zero=True), [*residual, cost]))
    else:
        panels += [Panel(x, Axis(label, zero=True), some) for label, some in ((_PIXELS, residual), (unit, [cost]))]
    title = f"{printable(result_name(result), 80)}: {status_text(result.status)}"
    return Figure(title, panels, 1, (7.0, 2.3 * len(panels)))


def _line(name: str, rounds: Sequence[Round], values: Sequence[float]) -> Series:
    hollow = [not r.accepted for r in rounds]
    return Series(name, range(1, len(rounds) + 1), [*values], "line", hollow=hollow if any(hollow) else ())


def _cost(result: Result) -> tuple[str, str]:
    """Return the name of the cost of a round and its unit."""
    judged = result.judged
    if judged is None or judged.judge == DIRECTED:
        return "directed cost", _PIXELS
    return judged.judge, _PIXELS if judged.unit == "px" else judged.unit
