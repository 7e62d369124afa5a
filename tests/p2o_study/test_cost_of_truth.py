"""The cost of the truth beside that of the estimate: it separates a failed search from a wrong cost."""

from __future__ import annotations

from dataclasses import replace

import p2o
from p2o import Recipe, Registry, se3
from p2o.results.figures import figure_values
from p2o.run.assembly import Assembly, given
from p2o.run.read_again import FrameInfo
from p2o_study.worker import with_cost_of_truth

DATA = "synthetic:?scenes=1&width_px=192&height_px=64&place=yard&right=false&lidar=vlp-16"


def calibrated(**words: str) -> tuple[Assembly, p2o.Frame, list[FrameInfo], list[dict[str, object]], p2o.Result]:
    plan = Recipe.of(data=DATA, witness="none", **words).resolve(Registry.load())
    frame, assembly = plan.dataset()[0], plan.assembly()
    infos = [FrameInfo(frame.name, frame.camera)]
    pieces = [{stage: assembly.stages[stage](given(frame, stage)) for stage in assembly.stages}]
    start = se3.exp([0.01, -0.01, 0.005, 0.03, 0.02, 0.0]) @ frame.camera_from_lidar
    return assembly, frame, infos, pieces, assembly.calibrated(infos, pieces, start)


def test_the_cost_of_the_truth_is_compared_with_that_of_the_estimate_on_the_same_points() -> None:
    words = {"extractor": "grey/reflectance", "matcher": "nid", "solver": "bfgs", "init": "given"}
    assembly, frame, infos, pieces, result = calibrated(**words)
    assert result.judged is not None
    truth = frame.camera_from_lidar

    def excess(estimate: p2o.Float) -> float:
        given_up = replace(result, camera_from_lidar=estimate)
        value = figure_values(with_cost_of_truth(assembly, infos, pieces, given_up, truth))["cost_excess_truth"]
        assert isinstance(value, float)
        return value

    assert excess(truth) == 0.0
    elsewhere = se3.exp([0.2, 0.1, 0.0, 0.0, 0.0, 0.0]) @ truth
    assert excess(elsewhere) < 0, "a search that ends at a higher cost than the truth has failed"
    assert with_cost_of_truth(assembly, infos, pieces, result, None).judged == result.judged


def test_a_method_without_a_cost_has_none() -> None:
    assembly, frame, infos, pieces, result = calibrated(calibrator="lccnet")
    assert figure_values(result)["cost_excess_truth"] is None
    assert with_cost_of_truth(assembly, infos, pieces, result, frame.camera_from_lidar) is result
