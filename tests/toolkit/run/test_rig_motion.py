"""A sweep that several cameras share has one motion: fused, or reported as a contradiction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o.calibration.nuisance import motion_prior_of
from p2o.calibration.options import PipelineOptions
from p2o.confidence.common_motion import CommonMotion
from p2o.results.result import Result, Status, SweepMotion
from p2o.results.verdict import Doubt, Trust
from p2o.run.assembly import Assembly
from p2o.run.recipe import Recipe
from p2o.run.rig_motion import CameraSweeps, with_common_motions

PRIOR = motion_prior_of(PipelineOptions())
STREET = "synthetic:?cameras=front,left&deskew=false&scenes=1&frames_per_scene=1&lidar=hdl-64e&right=false"


def motion(speed: float, sigma: float, turn_deg_s: float = 0.0, turn_sigma: float = 6.0) -> SweepMotion:
    return SweepMotion("frame", speed, sigma, turn_deg_s, turn_sigma, (0.0, 0.0, np.radians(turn_deg_s), speed, 0, 0))


def posterior(speed: float, sigma: float) -> SweepMotion:
    """The estimate of a camera that measures a speed, with the prior of 8 +- 8 m/s in it."""
    total = 1 / sigma**2 + 1 / PRIOR.speed_sigma**2
    mean = (speed / sigma**2 + PRIOR.expected.speed_m_s / PRIOR.speed_sigma**2) / total
    return motion(mean, total**-0.5)


def test_the_prior_of_the_motion_counts_once_and_a_camera_that_observes_none_adds_nothing() -> None:
    common = CommonMotion.of([posterior(3.0, 2.0), posterior(5.0, 1.0)], PRIOR)
    information = 1 / 2.0**2 + 1 / 1.0**2 + 1 / 8.0**2
    assert common.consistent
    assert common.speed_m_s == pytest.approx((3.0 / 4 + 5.0 + 8.0 / 64) / information)
    assert common.speed_sigma == pytest.approx(information**-0.5)
    common = CommonMotion.of([posterior(3.0, 1.0), motion(8.3, 7.9, 3.0, 5.9)], PRIOR)
    alone = CommonMotion.of([posterior(3.0, 1.0)], PRIOR)
    assert common == alone


def results(*motions: SweepMotion) -> list[CameraSweeps]:
    pose = np.eye(4)
    its = [Result(("frame",), pose, pose, Status.CONVERGED, "", motions=(each,)) for each in motions]
    return [CameraSweeps(name, each, {"frame": "sweep"}) for name, each in zip(("front", "side"), its, strict=True)]


@pytest.fixture(scope="module")
def assembly() -> Assembly:
    return Recipe.of(data=None).resolve(p2o.Registry.load()).assembly()


def test_motions_of_one_sweep_that_contradict_each_other_make_both_results_doubtful(assembly: Assembly) -> None:
    cameras = results(motion(-0.5, 0.6), motion(6.7, 0.7))
    out = with_common_motions(cameras, assembly, lambda number, again: pytest.fail("calibrated again"))
    for result in out:
        assert result.verdict.trust is Trust.DOUBTFUL
        [reason] = result.verdict.reasons
        assert reason.doubt is Doubt.CONTRADICTION
        assert "front -0.5 +- 0.6 m/s" in reason.text
        assert "side 6.7 +- 0.7 m/s" in reason.text
    cameras = [replace(camera, sweeps={"frame": camera.camera}) for camera in cameras]
    out = with_common_motions(cameras, assembly, lambda number, again: pytest.fail("calibrated again"))
    assert [result is camera.result for result, camera in zip(out, cameras, strict=True)] == [True, True]


def test_cameras_are_calibrated_again_with_the_motion_that_they_share(assembly: Assembly) -> None:
    cameras, asked = results(motion(4.0, 1.0), motion(5.0, 1.0)), []

    def solve(number: int, again: Assembly) -> Result:
        asked.append((number, again.twists["frame"], again.options))
        return replace(cameras[number].result, reason="again")

    first, second = with_common_motions(cameras, assembly, solve)
    assert first.reason == second.reason == "again"
    assert first.motions == second.motions
    assert 4.0 < first.motions[0].speed_m_s < 5.0
    for _, twist, options in asked:
        assert twist[3] == pytest.approx(first.motions[0].speed_m_s)
        assert (options.speed_m_s, options.speed_sigma_m_s) == (0.0, pytest.approx(first.motions[0].speed_sigma))


@pytest.mark.system
def test_two_cameras_of_a_simulated_rig_report_one_speed() -> None:
    told: list[object] = []
    run = p2o.calibrate(
        f"{STREET}&speed_m_s=3&seed=5",
        rig=True,
        perturb="1deg 0.1m",
        on_progress=lambda progress: told.append(progress.row) if progress.row is not None else None,
    )
    front, left = (row.result.motions[0] for row in run.rows)
    assert (front.speed_m_s, front.speed_sigma) == (left.speed_m_s, left.speed_sigma)
    assert abs(front.speed_m_s - 3.0) < 2 * front.speed_sigma
    assert told == list(run.rows)
    assert all(row.error is not None and row.error.rotation_deg < 0.5 for row in run.rows)
    assert [row.camera for row in run.rows] == ["front", "left"]
