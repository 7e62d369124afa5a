"""What image and sweep are of one moment is trusted; an image with the sweep of another place is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from p2o import Frame, View
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.host.registry import Registry
from p2o.run.pipeline import Pipeline
from p2o.run.recipe import Recipe

DATA = "synthetic:?scenes=4&seed=9&place=street&right=false&width_px=512&height_px=156"


@pytest.fixture(scope="module")
def seen() -> tuple[Pipeline, Sequence[Frame], Sequence[View]]:
    plan = Recipe.of(data=DATA, extractor="depth/rings").resolve(Registry.load())
    dataset, pipeline = plan.dataset(), plan.calibrator()
    frames = [dataset[number] for number in range(4)]
    return pipeline, frames, [pipeline.prepare(frame) for frame in frames]


def test_right_pairs_are_trusted_and_hold_what_they_say(seen: tuple[Pipeline, Sequence[Frame], Sequence[View]]) -> None:
    pipeline, frames, views = seen
    truth = frames[0].camera_from_lidar
    result = pipeline.solve(views, wrong_start(truth, 2.0, 0.15, np.random.default_rng(0)))
    error = pose_error(result.camera_from_lidar, truth)
    assert result.verdict.trusted, result.verdict.why
    assert error.rotation_deg <= result.accuracy.rotation_deg_95
    assert error.translation_m <= result.accuracy.translation_m_95


def test_the_sweep_of_another_place_is_not_trusted(seen: tuple[Pipeline, Sequence[Frame], Sequence[View]]) -> None:
    pipeline, frames, views = seen
    for number, view in enumerate(views):
        wrong = replace(view, cloud=views[(number + 1) % len(views)].cloud)
        start = wrong_start(frames[number].camera_from_lidar, 2.0, 0.15, np.random.default_rng(number))
        assert not pipeline.solve([wrong], start).verdict.trusted
