"""A store of synthetic runs, written through the store's own functions: what reports are made of in the tests."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import se3
from p2o.results.result import Status
from p2o.results.verdict import Trust
from p2o.solving import Round
from p2o_study.row import Case, Environment, Frame, Method, Row, frame_digest
from p2o_study.rows import PlanRow, Rows, StoredStudy, plan_of
from p2o_study.worker import content_digests
from p2o_testing import stage

TRUTH = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0.0, -0.1, -0.3])
PLUGIN = str(Path(__file__).with_name("stage_plugin.py"))
AXIS = np.array([2.0, 1.0, -2.0]) / 3

TOML = """
name = "table2"
title = "Table 2: KITTI & <others>"
note = "Starts are 2 deg and 0.15 m wrong."
[[dataset]]
name = "kitti"
data = "kitti:"
[[row]]
label = "ours"
calibrator = "spy"
"""

PUBLISHED = (
    {"label": "RGGNet", "source": "Yuan et al. 2020", "values": {"rotation_deg": 1.18, "translation_m": 0.088}},
    {
        "label": "ours",
        "source": "P2O-Calib, Table 2",
        "values": {"rotation_deg": 0.001, "translation_m": 0.001},
        "beside": "ours",
        "start": "2 deg, 0.15 m",
    },
)


def run_of(row: str, frame: str, seed: int, rotation_deg: float, shift_m: float, **values: Any) -> Row:
    """Return a run whose estimate is off by this turn and shift, each along an axis of its own.

    `values` are fields of the row, its case and its method.
    """
    turn, truth = se3.exp(np.array([*(np.radians(rotation_deg) * AXIS), 0, 0, 0])), values.get("truth")
    centre = TRUTH if truth is None else truth
    known: dict[str, Any] = {
        "section": "",
        "dataset": "kitti",
        "joint": 0,
        "protocol": "2deg 0.15m",
        "start": TRUTH @ se3.exp(np.array([0, np.radians(2), 0, 0, 0.15, 0])),
        "truth": TRUTH,
        "contents": {},
        "data": "",
        "words": {"matcher": "ogm"},
        "options": {},
        "status": Status.CONVERGED,
        "reason": "the last round moved the pose by less than the tolerance",
        "estimate": centre @ se3.make(turn[:3, :3], shift_m * AXIS[::-1]),
        "rounds": rounds((900, 18.0), (400, 4.0), (380, 2.0)),
        "matches": {"L": 200, "R": 180},
        "seconds": {"extract": 0.5, "refine": 0.25},
        "finished": "2026-01-01T00:00:00+00:00",
        **values,
    }
    names = known.pop("frames", (frame,))
    dataset, truth, contents = (known.pop(name) for name in ("dataset", "truth", "contents"))
    frames = tuple(Frame(dataset, name, contents.get(name, f"content of {name}"), truth) for name in names)
    case = Case(dataset, frames, seed, *(known.pop(name) for name in ("start", "protocol", "joint")))
    case = replace(case, data=known.pop("data"))
    method = Method("revision", known.pop("words"), known.pop("options"))
    known["status"] = Status(known["status"])
    if not known["status"].solved:
        known["estimate"] = None
    environment = Environment(versions={"numpy": "2"})
    return Row(f"{row} {names[0]} {seed}", row, case, method, environment=environment, **known)


def rounds(*history: tuple[int, float]) -> tuple[Round, ...]:
    """Return rounds with these numbers of matches and mean residuals, behind one of an initializer."""
    first = Round("initialize", 5.0, {}, math.nan, 3.0, 0.1, 0.01, accepted=True)
    return (
        first,
        *(replace(first, stage="refine", matches={"L": n}, mean_residual=px) for n, px in history),
    )


def table2(frames: int = 12, seeds: int = 3) -> list[Row]:
    """Return the runs of a study of three rows and a joint one; errors are of a seeded generator."""
    rng = np.random.default_rng(5)
    runs = []
    for row, scale in (("ours w/o OGM", 2.0), ("ours w/o UB", 0.35), ("ours", 0.3)):
        for frame in range(frames):
            hard = rng.gamma(2.0, 0.5)
            for seed in range(seeds):
                turn, shift = scale * hard * rng.normal(), 0.4 * scale * hard * rng.normal()
                runs.append(run_of(row, f"2011_09_26/drive_0005/{frame:010d}", seed, turn, shift, **_judged(turn)))
    for seed in range(seeds):
        names = tuple(f"2011_09_26/drive_0005/{frame:010d}" for frame in range(frames))
        runs.append(run_of("ours, jointly", names[0], seed, 0.05 + 0.01 * seed, 0.01, frames=names, joint=frames))
    return runs


def _judged(turn: float) -> dict[str, Any]:
    """Return status, verdict and evidence of a run that is off by this turn: the wronger, the less trusted."""
    few = "12 pairs within 50 px, at least 30 are needed"
    if abs(turn) > 4:
        return {"status": "too-few-matches", "reason": few, "trust": Trust.REFUSED, "why": few}
    figures: dict[str, Any] = {
        "odds_ratio": 12.5 / (1 + abs(turn)),
        "cost_initial": 4.25,
        "cost_result": 3.5,
        "cost_unit": "px",
        "judge": "directed-distance",
        "predicted_rotation_deg": 0.25,
        "predicted_translation_m": 0.05,
        "predicted_rotation_deg_95": 0.75,
        "predicted_translation_m_95": 0.15,
    }
    found: dict[str, Any] = {"trust": Trust.TRUSTED, "why": "", "figures": figures}
    if abs(turn) > 1.5:
        found |= {"trust": Trust.DOUBTFUL, "why": "image and LiDAR edges meet little more often than by chance"}
    elif abs(turn) > 1:
        rival = {"lead": 1.25, "unit": "edges", "rotation_deg": 1.61, "translation_m": 0.2}
        found |= {"trust": Trust.AMBIGUOUS, "why": "another pose, 1.61 deg and 0.20 m away, fits as well"}
        figures |= {f"rival_{name}": value for name, value in rival.items()}
    return found


def staged(**values: Any) -> list[Row]:
    """Return runs on the frames of the stage that tests draw, by the staged pipeline and by a whole method."""
    frame = stage.frame()
    truth = frame.camera_from_lidar
    assert truth is not None
    words = {"edges": {"extractor": "depth/rings"}, "whole": {"calibrator": "spy"}}
    registry = p2o.Registry.load(extra_files=[PLUGIN], environ={})
    names = ("drive/0000", "drive/0001", "drive/0002")
    content = frame_digest(content_digests(frame), truth)
    start = truth @ np.array([[1.0, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    common = {"truth": truth, "start": start, "dataset": "fake", "data": "fake", **values}
    common = {"contents": dict.fromkeys(names, content), **common}
    runs = []
    for row, own in words.items():
        options = p2o.Recipe.of(data="fake:?frames=3", **own).resolve(registry).described()["options"]
        options = {stage: values for stage, values in options.items() if stage != "data"}
        runs += [
            run_of(row, name, 0, 1.0 + i, 0.1, words=own, options=options, **common) for i, name in enumerate(names)
        ]
    return runs


def toml_of(published: Sequence[Mapping[str, Any]]) -> str:
    """Return the tables of published figures of a study file."""
    text = ""
    for table in published:
        values = ", ".join(f"{name} = {value}" for name, value in table["values"].items())
        text += "[[published]]\n" + "".join(f'{k} = "{v}"\n' for k, v in table.items() if k != "values")
        text += f"values = {{ {values} }}\n"
    return text


def write_store(
    folder: Path,
    runs: Sequence[Row],
    *,
    study: str = "table2",
    missing: Sequence[PlanRow] = (),
    toml: str = TOML,
    published: Sequence[Mapping[str, Any]] = PUBLISHED,
) -> Path:
    """Write runs as one study, and return the folder; `published` are tables of its file."""
    text = toml.replace('name = "table2"', f'name = "{study}"') + toml_of(published)
    rows = Rows(folder)
    rows.begin(StoredStudy(study, tomllib.loads(text), (*plan_of(runs), *missing)))
    for run in runs:
        rows.put(study, run)
    return folder
