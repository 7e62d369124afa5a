"""Build, label and train the regressors; heavy packages are imported when they are used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import p2o
from p2o import UInt8
from p2o.reading import expanded, weights_of

from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.options import PRESETS, RegressorOptions, TrainingOptions


def label(frame: p2o.Frame) -> bytes:
    """Return the content of a label file of a frame; raises InputError if the frame cannot be used for training."""
    from p2o_baselines.regressors.sample import sample_of

    return sample_of(frame).packed()


def draw(path: Path) -> UInt8:
    """Return the image (H, W, 3) of a label file."""
    from p2o_baselines.regressors.sample import Sample, labelled_image

    return labelled_image(Sample.load(path))


OTHER_RIG = tuple(
    (check, "a network is specific to the rig of its training data, and the stage has another one")
    for check in ("calibrator_comes_near_the_truth", "what_is_solved_is_no_start")
)
"""Checks that weights of one rig cannot pass on another one."""


def built(design: Design, options: RegressorOptions) -> p2o.Calibrator:
    """Return the calibrator of a design with the weights that its options name."""
    from p2o_baselines.regressors import staged

    return staged.build(design, options, weights_files(options.weights, design))


def weights_files(weights: str, design: Design) -> list[Path]:
    """Return the files that the option `weights` names; raises MethodUnavailable for a size without weights."""
    if weights in design.inputs:
        try:
            return [weights_of(design.name, weights).path]
        except p2o.UnknownNameError as problem:
            raise p2o.MethodUnavailable(
                f"no weights of {design.name} of size {weights} are installed",
                where="weights",
                expected="the package p2o-kitti-weights (for research only), or a file written by p2o train",
                hint="pip install p2o-kitti-weights, or "
                f"p2o train {design.name} --data ... --out DIR, then weights=DIR/weights.safetensors",
            ) from problem
    return [expanded(part.strip()) for part in weights.split(",") if part.strip()] or [Path(weights)]


def trainer(design: Design) -> p2o.Trainer:
    """Return how a design is trained."""

    def train(options: TrainingOptions, *rest: Any) -> Path:
        from p2o_baselines.regressors import training

        return training.train(design, options, *rest)

    return p2o.Trainer(options=TrainingOptions, presets=PRESETS, label=label, draw=draw, train=train, label_version=1)


def regressor(design: Design, build: Callable[[RegressorOptions], p2o.Calibrator], **about: Any) -> p2o.Method:
    """Return the method of a design; `build` is defined in the file of the method, by which it is found."""
    return p2o.Method(
        name=design.name,
        build=build,
        options=RegressorOptions,
        expected_failures=OTHER_RIG,
        data_files=lambda options: weights_files(options.weights, design),
        data_licence=lambda options: (
            weights_of(design.name, options.weights).licence if options.weights in design.inputs else ""
        ),
        trainer=trainer(design),
        **about,
    )
