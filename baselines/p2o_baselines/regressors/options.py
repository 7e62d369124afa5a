"""Options of training and use, importable without torch."""

from __future__ import annotations

from typing import Any, Literal

import p2o
from p2o import field
from pydantic import field_validator


class Augmentation(p2o.Options):
    """How much what a network learns from differs from the frames that it comes from."""

    zoom: float = field(1.25, ge=1, le=4, help="Windows of a picture are enlarged by up to this, with its intrinsics.")
    mirror: bool = field(True, help="Mirror half of the frames: picture and points.")
    light: float = field(1.0, ge=0, le=3, help="Strength of changes of exposure, contrast, colour, noise; 0: off.")
    most_points: int = field(20_000, ge=100, help="Points of a sweep at most, half of those of a KITTI sweep ahead.")
    thin: float = field(0.5, gt=0, le=1, help="Keep at least this share of them.")
    turn_deg: float = field(
        0.0, ge=0, le=30, help="Turn the camera by up to this about each axis: frames of other rigs. No paper does."
    )
    reexpress: bool = field(False, help="Express sweeps in a LiDAR frame drawn by chance. No paper does.")


class TrainingOptions(p2o.Options):
    """How a network is trained; the defaults are for a laptop without a GPU."""

    size: Literal["small", "paper"] = field("small", help="The network: one that trains on a CPU, or the paper's.")
    stages: tuple[tuple[float, float], ...] = field(
        (), help="Ranges of starts, deg and m about and along each axis, from the widest; empty: those of the method."
    )
    iterations: int = field(6000, ge=1, help="Steps of the optimiser.")
    batch: int = field(16, ge=1, le=1024, help="Samples in each step; of windows, frames.")
    learning_rate: float = field(1.5e-3, gt=0, le=1, help="Highest learning rate.")
    weight_decay: float = field(0.01, ge=0, le=1, help="Decoupled weight decay.")
    average: float = field(0.998, ge=0, lt=1, help="Decay of the running average of weights that is kept; 0: off.")
    points: int = field(256, ge=16, le=65536, help="Points of a sample by which losses compare clouds.")
    match: float = field(
        0.0,
        ge=0,
        le=100,
        help="Weight of a loss that makes features of a point alike in sweep and picture; no paper has it.",
    )
    from_weights: str = field("", help="Begin from these weights of the same method and size: a file.")
    branches: str = field("", help="Begin with what fits of branches and trunk in another method's weights: a file.")
    validate_every: int = field(250, ge=1, help="Steps from one validation (and checkpoint) to the next.")
    seed: int = field(0, ge=0, le=2**63 - 1, help="Seed of the first weights and of all that is drawn.")
    augmentation: Augmentation = field(Augmentation(), help="How much samples differ from frames.")

    @field_validator("stages")
    @classmethod
    def _ranges(cls, value: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
        if not all(0 < deg <= 90 and 0 < metres <= 10 for deg, metres in value):
            raise ValueError("ranges within 90 deg and 10 m, both above zero")
        return value


PRESETS: dict[str, dict[str, Any]] = {
    "small": {},
    "paper": {"size": "paper", "iterations": 300_000, "batch": 32, "learning_rate": 1e-4, "validate_every": 5000},
}
"""What a CPU trains in less than an hour, and the network of the paper, one stage at a time, for a GPU."""


class RegressorOptions(p2o.Options):
    """How trained networks are used."""

    weights: str = field(
        "small",
        help="small (shipped, where the method has them; for research only), or files that p2o train wrote, parted by "
        "commas, from the widest stage to the nearest.",
    )
    first: int = field(
        1, ge=1, le=100, help="Stage to begin with, counted from 1: starts that are near need no wide one."
    )
    rounds: int = field(1, ge=1, le=100, help="Times that every stage is used.")
    median: Literal["end", "each"] = field(
        "end", help="Frames together: the median of their results, at the end (as published) or after each stage."
    )
    device: str = field("auto", pattern="^(auto|cpu|cuda(:[0-9]+)?)$", help="auto takes a GPU where there is one.")
