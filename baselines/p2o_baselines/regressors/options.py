"""Options of training and use, importable without torch."""

from __future__ import annotations

from typing import Any, Literal

import p2o
from p2o import field
from pydantic import field_validator


class Augmentation(p2o.Options):
    """Augmentation of the samples of a training."""

    zoom: float = field(1.25, ge=1, le=4, help="Largest zoom of random crops, with adapted intrinsics.")
    mirror: bool = field(True, help="Mirror half of the frames: image and points.")
    light: float = field(1.0, ge=0, le=3, help="Strength of changes of exposure, contrast, colour, noise; 0: off.")
    most_points: int = field(20_000, ge=100, help="Largest number of points per sweep; KITTI has twice as much.")
    thin: float = field(0.5, gt=0, le=1, help="Least share of these points that is kept.")
    turn_deg: float = field(
        0.0, ge=0, le=30, help="Largest random rotation about each axis: other rigs (not in papers)."
    )
    reexpress: bool = field(False, help="Express sweeps in a random LiDAR frame (not in the papers).")


class TrainingOptions(p2o.StepOptions):
    """How a network is trained; the defaults are for a laptop without a GPU."""

    size: Literal["small", "paper"] = field("small", help="Network size: for training on a CPU, or that of the paper.")
    stages: tuple[tuple[float, float], ...] = field(
        (), help="Ranges of initial errors, deg and m per axis, largest first; empty: those of the method."
    )
    iterations: int = field(6000, ge=1, help="Steps of the optimiser.")
    batch: int = field(16, ge=1, le=1024, help="Samples per step; frames if the method uses windows.")
    learning_rate: float = field(1.5e-3, gt=0, le=1, help="Highest learning rate.")
    weight_decay: float = field(0.01, ge=0, le=1, help="Decoupled weight decay.")
    average: float = field(0.998, ge=0, lt=1, help="Decay of the exponential moving average of the weights; 0: off.")
    points: int = field(256, ge=16, le=65536, help="Points per sample in losses that compare clouds.")
    match: float = field(0.0, ge=0, le=100, help="Weight of a loss that matches features of both sensors (ours).")
    from_weights: str = field("", help="File of initial weights of the same method and size.")
    branches: str = field("", help="File of any method's weights: initial branches and trunk, if of the same shape.")
    validate_every: int = field(250, ge=1, help="Steps from one validation (and checkpoint) to the next.")
    seed: int = field(0, ge=0, le=2**63 - 1, help="Seed of initial weights and of sampling.")
    augmentation: Augmentation = field(Augmentation(), help="Augmentation of the samples.")

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
        help="small (for research only; of the package p2o-kitti-weights), or files written by p2o train, separated by "
        "commas, from the largest range to the smallest.",
    )
    first: int = field(1, ge=1, le=100, help="First stage, counted from 1: small initial errors need no large range.")
    device: str = field("auto", pattern="^(auto|cpu|cuda(:[0-9]+)?)$", help="auto uses a GPU if there is one.")
