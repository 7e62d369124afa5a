"""A store of synthetic runs, written through the store's own functions: what reports are made of in the tests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import se3
from p2o.cache import content_hash
from p2o.geometry.pose_error import pose_error
from p2o.results.verdict import Trust
from p2o.solving import Round
from p2o_study.store import Planned, Store, StoredRow, StoredStudy
from p2o_testing import stage

TRUTH = se3.make(np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]]), [0.0, -0.1, -0.3])
PLUGIN = str(Path(__file__).with_name("stage_plugin.py"))
AXIS = np.array([2.0, 1.0, -2.0]) / 3

TOML = """
name = "table2"
title = "Table 2: KITTI & <others>"
note = "Starts are 2 deg and 0.15 m wrong."
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


def planned(run: StoredRow) -> Planned:
    """Return what the study asked for."""
    return Planned(**{name: getattr(run, name) for name in Planned.__dataclass_fields__})


def run_of(
    row: str, frame: str, seed: int, rotation_deg: float, shift_m: float, *, study: str = "table2", **values: Any
) -> StoredRow:
    """Return a run whose estimate is off by this turn and shift, each along an axis of its own."""
    turn = se3.exp(np.array([*(np.radians(rotation_deg) * AXIS), 0, 0, 0]))
    estimate = TRUTH @ se3.make(turn[:3, :3], shift_m * AXIS[::-1])
    error = pose_error(estimate, TRUTH)
    start = TRUTH @ se3.exp(np.array([0, np.radians(2), 0, 0, 0.15, 0]))
    common: dict[str, Any] = {
        "dataset": "kitti",
        "frames": (frame,),
        "seed": seed,
        "perturb": "2deg 0.15m",
        "status": "converged",
        "reason": "the last round moved the pose by less than the tolerance",
        "rotation_deg": error.rotation_deg,
        "translation_m": error.translation_m,
        **error.per_axis,
        "start_rotation_deg": 2.0,
        "start_translation_m": 0.15,
        "estimate": estimate,
        "start": start,
        "truth": TRUTH,
        "rounds": rounds((900, 18.0), (400, 4.0), (380, 2.0)),
        "matches": {"L": 200, "R": 180},
        "seconds": {"extract": 0.5, "refine": 0.25},
        "recipe": {"matcher": "ogm", "seed": seed},
        "versions": {"numpy": "2"},
        "finished": "2026-01-01T00:00:00+00:00",
    }
    return StoredRow(f"{study} {row} {frame} {seed}", study, row, **{**common, **values})


def rounds(*history: tuple[int, float]) -> tuple[Round, ...]:
    """Return rounds with these numbers of matches and mean residuals, behind one of an initializer."""
    first = Round("initialize", 5.0, {}, math.nan, 3.0, 0.1, 0.01, accepted=True)
    return (
        first,
        *(replace(first, stage="refine", matches={"L": n}, mean_residual=px) for n, px in history),
    )


def table2(frames: int = 12, seeds: int = 3) -> list[StoredRow]:
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


def staged(**values: Any) -> list[StoredRow]:
    """Return runs on the frames of the stage that tests draw, by the staged pipeline and by a whole method."""
    frame = stage.frame()
    truth = frame.camera_from_lidar
    registry = p2o.Registry.load(extra_files=[PLUGIN], environ={})
    words = {"data": "fake:?frames=3"}
    recipes = {
        "edges": p2o.Recipe.of(**words, extractor="depth/rings").resolve(registry).described(),
        "whole": p2o.Recipe.of(**words, calibrator="spy").resolve(registry).described(),
    }
    inputs = {"image": content_hash(frame.image), "cloud": content_hash(frame.cloud)}
    start = truth @ np.array([[1.0, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    common = {"truth": truth, "start": start, "estimate": truth, "dataset": "fake", **values}
    return [
        run_of(row, name, 0, 1.0 + i, 0.1, recipe=recipe, inputs={name: inputs}, **common)
        for row, recipe in recipes.items()
        for i, name in enumerate(("drive/0000", "drive/0001", "drive/0002"))
    ]


def write_store(
    folder: Path,
    runs: Sequence[StoredRow],
    *,
    missing: Sequence[Planned] = (),
    toml: str = TOML,
    published: Sequence[Mapping[str, Any]] = PUBLISHED,
) -> Path:
    """Write runs as one study, and return the folder."""
    name = (*runs, *missing)[0].study
    study = StoredStudy(name, toml, {}, tuple(published))
    with Store.open(folder) as store:
        store.begin(study, [*map(planned, runs), *missing])
        for run in runs:
            store.put(run)
    return folder
