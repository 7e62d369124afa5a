"""The trainer of a method, guarded: a fault of the plugin is reported with its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.frames.frame import Frame
from p2o.host.method import Trainer
from p2o.host.registry import Offer, fault, watch


def trainer_of(offer: Offer) -> Trainer:
    """Return the trainer of an offer, guarded as `build` guards a stage.

    Raises InputError where the method does not learn.
    """
    trainer = offer.method.trainer
    if trainer is None:
        raise InputError(f"{offer.kind} '{offer.name}' cannot be trained", expected="a method that learns")

    def label(frame: Frame) -> bytes:
        with watch(offer, f"labelling {frame.name}"):
            content = trainer.label(frame)
        if not isinstance(content, bytes):
            raise fault(offer, f"label returned {type(content).__name__}", "the bytes of a file")
        return content

    def draw(path: Path) -> Any:
        with watch(offer, f"drawing {path}"):
            return trainer.draw(path)

    def train(*arguments: Any) -> Path:
        with watch(offer, "training"):
            weights = trainer.train(*arguments)
        if not isinstance(weights, Path) or not weights.is_file():
            raise fault(offer, "train returned no file", "the path of the weights")
        return weights

    return replace(trainer, label=label, draw=draw, train=train)
