"""What the methods share: how they are built, labelled and trained; nothing heavy is imported before it is used."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import p2o
from p2o.arrays import UInt8

from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.options import PRESETS, RegressorOptions, TrainingOptions


def label(frame: p2o.Frame) -> bytes:
    """Return the content of a label file of a frame; raises InputError where the frame teaches nothing."""
    from p2o_baselines.regressors.lesson import lesson_of

    return lesson_of(frame).packed()


def draw(path: Path) -> UInt8:
    """Return the picture (H, W, 3) of a label file."""
    from p2o_baselines.regressors.lesson import Lesson, picture

    return picture(Lesson.load(path))


OTHER_RIG = tuple(
    (check, "a network knows the rig that it has learnt, and the stage is another")
    for check in ("calibrator_comes_near_the_truth", "what_is_solved_is_no_start")
)
"""Checks that weights of one rig cannot pass on another one."""


def built(design: Design, options: RegressorOptions) -> p2o.Calibrator:
    """Return the calibrator of a design with the weights that its options name."""
    from p2o_baselines.regressors import staged

    return staged.build(design, options)


def trainer(design: Design) -> p2o.Trainer:
    """Return how a design is trained."""

    def train(
        options: TrainingOptions,
        groups: Sequence[p2o.TrainingGroup],
        validation: Sequence[Path],
        out: Path,
        report: Callable[[p2o.TrainingProgress], None],
    ) -> Path:
        from p2o_baselines.regressors import training

        return training.train(design, options, groups, validation, out, report)

    return p2o.Trainer(options=TrainingOptions, presets=PRESETS, label=label, draw=draw, train=train, label_version=1)
