"""The convergence figure is written, tells directions by colour, and leaves matplotlib's state alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o import InputError, Result, Status
from p2o.draw.overlay import COLOURS
from p2o.page.convergence import convergence as figure_of
from p2o.page.figure import drawn, save_figure
from p2o.results.evidence import Judged
from p2o.solving import Round


def _result(rounds: tuple[Round, ...]) -> Result:
    return Result(("scene-0000",), np.eye(4), np.eye(4), Status.CONVERGED, "", rounds)


def _round(matches: dict[str, int], residual: float = 1.0, *, accepted: bool = True) -> Round:
    return Round("refine", 20.0, matches, residual, 2.0, 0.1, 0.01, accepted)


def convergence(result: Result, path: Path) -> None:
    save_figure(drawn(figure_of(result)), path)


def _has(path: Path, letter: str) -> bool:
    import cv2

    rgb = cv2.imread(str(path))[..., ::-1].astype(int)
    return bool((np.abs(rgb - COLOURS[letter]).max(axis=2) <= 2).sum() > 200)


def test_matches_are_drawn_in_the_colours_of_their_directions_by_the_same_bytes(tmp_path: Path) -> None:
    path = tmp_path / "convergence.png"
    nan = float("nan")
    rounds = (_round({}, nan), _round({"L": 40, "U": 80}), _round({"L": 50, "U": 90}, accepted=False))
    convergence(_result(rounds), path)
    assert {letter: _has(path, letter) for letter in COLOURS} == {"L": True, "R": False, "U": True, "B": False}
    for name in ("a.png", "b.png"):
        convergence(_result((_round({"L": 4}), _round({"L": 5}))), tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with pytest.raises(InputError, match="cannot write the file"):
        convergence(_result(()), tmp_path / "nowhere" / "convergence.png")


@pytest.mark.parametrize("rounds", [(), (_round({"-": 12}),)])
def test_a_result_without_rounds_or_directions_can_be_drawn(tmp_path: Path, rounds: tuple[Round, ...]) -> None:
    path = tmp_path / "convergence.png"
    convergence(_result(rounds), path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert not any(_has(path, letter) for letter in COLOURS)


def test_costs_in_another_unit_have_a_panel_of_their_own() -> None:
    rounds = tuple(replace(_round({"L": 9}, 2.0 - i), cost=-1.0 - i) for i in range(2))
    judged = Judged("mutual-information", "bit", -0.5, -2.0)
    panels = []
    for some in (rounds, tuple(replace(r, mean_residual=float("nan")) for r in rounds)):
        panels += [figure_of(replace(_result(some), judged=judged)).panels, figure_of(_result(some)).panels]
    units = [[panel.y.title for panel in each] for each in panels]
    assert units == [["matches", "pixels", "bit"], ["matches", "pixels"], ["matches", "bit"], ["matches", "pixels"]]
    names = [series.name for panel in panels[0] for series in panel.series]
    assert names == ["L", "mean residual", "mutual-information"]
