"""A rough initial guess that the search near it cannot correct leads to the wide search; others name its option."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.geometry.pose_error import pose_error
from p2o.results.result import Result
from p2o.run.read_again import FrameInfo
from p2o.run.recipe import Recipe
from p2o.solving import Pipeline

from tests import edge_scene

WORDS = "roughly x forward, z up; camera looks forward"
TILT = se3.exp(np.array([np.radians(14.0), np.radians(6.0), 0, 0, 0, 0]))
TRUTH = TILT @ se3.make(edge_scene.AXES, [0.02, -0.08, -0.27])
ROUGH = se3.make(edge_scene.AXES, np.zeros(3))


def solved(begin: np.ndarray, /, **words: str) -> Result:
    assembly = Recipe.of(data=None, **words).resolve(p2o.Registry.load()).assembly()
    assert isinstance(assembly.calibrator, Pipeline)
    view = edge_scene.view(truth=TRUTH, boxes=30, seed=4, noise_px=0.3)
    pieces = {"extractor": view.image, "cloud": view.cloud}
    return assembly.calibrated([FrameInfo("frame", view.camera)], [pieces], begin)


def error_deg(result: Result) -> float:
    return pose_error(result.camera_from_lidar, TRUTH).rotation_deg


def test_a_rough_start_beyond_the_reach_or_far_from_a_trusted_result_leads_to_the_wide_search() -> None:
    result = solved(ROUGH, start=WORDS)
    assert error_deg(result) < 0.5
    assert any("wide search" in text for text in result.warnings)
    # On KITTI such a result was trusted with an error of 2.5 deg, which the wide search corrected.
    result = solved(se3.exp(np.array([np.radians(5.0), 0, 0, 0, 0, 0])) @ TRUTH, start=WORDS)
    assert error_deg(result) < 0.5
    assert any("5.0 deg from it" in text for text in result.warnings)


def test_a_start_that_is_no_rough_one_names_the_wide_search_in_one_line() -> None:
    result = solved(ROUGH)
    assert error_deg(result) > 2.0
    [text] = [text for text in result.warnings if "--init far" in text]
    assert "4 deg" in text
    assert "\n" not in text


def test_a_trusted_result_runs_no_wide_search() -> None:
    near = se3.exp(np.array([0.02, 0, 0, 0, 0, 0])) @ TRUTH
    result = solved(near, start=WORDS)
    assert (result.verdict.trusted, result.warnings) == (True, ())


@pytest.mark.parametrize("words", [{"start": WORDS, "init": "grid"}, {}])
def test_another_initializer_or_start_has_no_wide_search(words: dict[str, str]) -> None:
    assert Recipe.of(data=None, **words).resolve(p2o.Registry.load()).assembly().wide is None


def test_a_recipe_with_a_wide_search_repeats_from_its_description() -> None:
    plan = Recipe.of(data=None, start=WORDS).resolve(p2o.Registry.load())
    again = Recipe.of(**plan.described()).resolve(p2o.Registry.load())
    assert again.described() == plan.described()
    assert "wide" in again.parts
