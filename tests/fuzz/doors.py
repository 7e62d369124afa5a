"""Every input that is mutated, by name: how often it is drawn, and how."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from random import Random

from tests.fuzz import containers, surfaces
from tests.fuzz.bases import Bases
from tests.fuzz.surfaces import OUT, Case, Draw

SURFACES: Mapping[str, tuple[int, Draw]] = {
    "sweep": (20, surfaces.sweep),
    "picture": (13, surfaces.picture),
    "frame-file": (14, surfaces.frame_file),
    "rig": (5, surfaces.rig),
    "layout": (18, surfaces.layout),
    "bag": (8, surfaces.bag),
    "calibration": (4, surfaces.calibration),
    "words": (16, surfaces.words),
    "study": (7, surfaces.study),
    "result": (4, surfaces.result),
    "weights": (1, surfaces.weights),
    "pairs": (3, surfaces.pairs),
    "bag-tables": (5, containers.bag_tables),
    "mcap": (5, containers.mcap_records),
    "columns": (5, containers.columns),
    "xml": (4, containers.document),
    "las": (4, containers.las),
    "plugin": (6, containers.plugin),
}
"""Every door by name: how often it is drawn, and how."""


def draw(rng: Random, bases: Bases, home: Path, names: Sequence[str]) -> tuple[str, Case]:
    """Return the name of a door and a case at it, whose files are written to `home`."""
    (home / "in").mkdir(parents=True)
    (home / OUT).mkdir()
    name = rng.choices(names, [SURFACES[name][0] for name in names])[0]
    if name == "layout":
        (home / "in").rmdir()
    return name, SURFACES[name][1](rng, bases, home)
