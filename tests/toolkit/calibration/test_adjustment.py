"""The motion of the car during a sweep, told by the pairs of both sensors along with pose and cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.calibration.adjustment import Adjustment, MotionFit, Nuisance, fit_with_nuisances
from p2o.geometry.motion import EgoMotion, MotionPrior, moved
from p2o.geometry.pose_error import pose_error
from p2o.reading import RadialError
from p2o.results.result import TimeOffset
from p2o.solving import PointToLine
from p2o_plugins.solve.lm import METHOD as LM

from tests.edge_scene import PINHOLE, TRUTH
from tests.plugins.solve.exact_pairs import NEAR, pairs
from tests.plugins.solve.test_solvers import built

PRIOR = MotionPrior(EgoMotion(8.0), 8.0, 0.1)
MOTIONS = (EgoMotion(15.0, 0.08), EgoMotion(-1.0, -0.15))


def fitted(
    problem: PointToLine, pose: np.ndarray, *, fits_cameras: bool = True, motions: tuple[EgoMotion, ...] = (), **values
) -> Adjustment:
    """Return the fit of pairs whose points are compensated for these motions; raw ones without."""
    if "prior" in values:
        motions = motions or (EgoMotion(),) * len(problem.cameras)
        values["motions"] = tuple(MotionFit(motion, values["prior"].covariance) for motion in motions)
    return fit_with_nuisances(problem, pose, Nuisance(**values), fits_cameras=fits_cameras)


def as_measured(problem: PointToLine, motions: tuple[EgoMotion, ...] = MOTIONS) -> PointToLine:
    """Return pairs with the points where a LiDAR that turns ten times a second and moves has measured them."""
    xyz, time_s = np.array(problem.xyz), np.zeros(len(problem))
    for number, motion in enumerate(motions):
        rows = np.flatnonzero(problem.frame == number)
        time_s[rows] = -np.arctan2(xyz[rows, 1], xyz[rows, 0]) / (2 * np.pi) * 0.1 - 0.004
        xyz[rows] = moved(motion.twist, -time_s[rows], xyz[rows])
    return replace(problem, xyz=xyz, time_s=time_s)


def test_exact_pairs_tell_motions_and_pose_and_without_times_the_motion_stays_what_is_expected() -> None:
    problem = as_measured(pairs(count=1500))
    found = fitted(problem, NEAR, fits_cameras=False, prior=PRIOR)
    for fit, true in zip(found.motions, MOTIONS, strict=True):
        # Drawn to what is expected a little.
        assert fit.motion.speed_m_s == pytest.approx(true.speed_m_s, abs=0.25)
        assert fit.motion.turn_rad_s == pytest.approx(true.turn_rad_s, abs=0.005)
    error = pose_error(found.camera_from_lidar, TRUTH)
    assert error.rotation_deg < 0.01
    assert error.translation_m < 0.002
    assert found.cameras == ()
    spoilt = fitted(problem, NEAR, fits_cameras=False)  # by motion that nobody asks for
    assert spoilt.motions == ()
    assert pose_error(spoilt.camera_from_lidar, TRUTH).translation_m > 0.01
    # Without times the motion stays what is expected.
    found = fitted(pairs(), NEAR, prior=PRIOR)
    for fit in found.motions:
        assert (fit.motion.speed_m_s, fit.motion.turn_rad_s) == pytest.approx((8.0, 0.0))
        assert np.sqrt(np.diag(fit.covariance)) == pytest.approx([8.0, 0.1], rel=1e-6)


def test_points_that_are_corrected_already_give_the_same_motions() -> None:
    problem = as_measured(pairs(count=1500))
    known = (EgoMotion(12.0, 0.05), EgoMotion(3.0, -0.1))
    xyz = np.array(problem.xyz)
    for number, motion in enumerate(known):
        rows = problem.frame == number
        xyz[rows] = moved(motion.twist, problem.time_s[rows], xyz[rows])
    once = fitted(problem, NEAR, prior=PRIOR)
    again = fitted(replace(problem, xyz=xyz), NEAR, prior=PRIOR, motions=known)
    for a, b in zip(once.motions, again.motions, strict=True):
        assert a.motion.speed_m_s == pytest.approx(b.motion.speed_m_s, abs=0.05)
        assert a.motion.turn_rad_s == pytest.approx(b.motion.turn_rad_s, abs=1e-3)
    assert pose_error(once.camera_from_lidar, again.camera_from_lidar).translation_m < 5e-4


def test_motion_and_camera_are_told_apart() -> None:
    error = RadialError(-0.004, 0.012)
    exact = pairs(cameras=(error.corrected(PINHOLE),) * 2, count=3000)
    found = fitted(as_measured(replace(exact, cameras=(PINHOLE,) * 2)), NEAR, prior=PRIOR)
    (camera,) = found.cameras
    assert camera.error.focal == pytest.approx(error.focal, abs=3e-4)
    assert camera.error.radial == pytest.approx(error.radial, abs=5e-4)
    assert [fit.motion.speed_m_s for fit in found.motions] == pytest.approx([15.0, -1.0], abs=0.4)


def test_motions_or_an_offset_that_are_unknown_as_well_make_the_place_along_the_road_less_sure() -> None:
    standing = EgoMotion()
    problem = as_measured(pairs(count=400, noise_px=0.7), (standing, standing))
    alone = fitted(problem, TRUTH, fits_cameras=False).covariance
    more = fitted(problem, TRUTH, fits_cameras=False, prior=MotionPrior(standing, 8.0, 0.1)).covariance
    assert np.linalg.eigvalsh(more - 0.95 * alone).min() > 0
    assert more[5, 5] > 1.5 * alone[5, 5]  # along the road, the way it drives
    problem = pairs(count=300, cameras=FOUR, noise_px=0.7)
    alone = fitted(problem, NEAR, fits_cameras=False)
    both = fitted(problem, NEAR, fits_cameras=False, twists=SPEEDS, time=UNKNOWN)
    ratio = np.diag(both.covariance) / np.diag(alone.covariance)
    assert ratio[5] > 1.5, "z of the camera is along the road"
    assert ratio[4] < 1.3


def test_with_nothing_else_unknown_the_pose_is_that_of_the_solver_and_few_places_give_no_covariance() -> None:
    problem = pairs(count=400, noise_px=0.7, outliers=0.05)
    solution = built(LM)(problem, NEAR)
    found = fitted(problem, solution.camera_from_lidar, fits_cameras=False)
    assert pose_error(found.camera_from_lidar, solution.camera_from_lidar).translation_m < 1e-5
    assert found.covariance == pytest.approx(found.covariance.T)
    # Its pairs err one by one, so that both take the same for noise.
    ratio = np.diag(found.covariance) / np.diag(solution.covariance)
    assert ((ratio > 0.5) & (ratio < 2.0)).all()
    assert found.step_px < 1e-3
    problem = pairs(count=400)
    one = replace(problem, centre=np.tile([600.0, 180.0], (len(problem), 1)), frame=np.zeros(len(problem), np.int64))
    assert fitted(one, TRUTH, fits_cameras=False).covariance is None


@pytest.mark.parametrize("together", [False, True])
def test_the_covariance_foretells_the_scatter_also_of_pairs_that_err_together(together: bool) -> None:
    # Pairs of one direction in one cell of 64 px have the same error, as those along one outline have.
    squares, alone = [], []
    for seed in range(20):
        problem = pairs(count=500)
        rng = np.random.default_rng(seed)
        cell = np.floor(problem.centre / 64).astype(int)
        _, place = np.unique(np.column_stack([problem.frame, problem.side, cell]), axis=0, return_inverse=True)
        noise = rng.normal(0, 0.4, len(problem))
        if together:
            noise = rng.normal(0, 0.4, place.max() + 1)[place.reshape(-1)]
        noisy = replace(problem, centre=problem.centre + noise[:, None] * problem.normal)
        found = fitted(noisy, TRUTH, fits_cameras=False)
        error = se3.log(found.camera_from_lidar @ se3.inverse(TRUTH))
        assert found.covariance is not None
        squares.append(error @ np.linalg.solve(found.covariance, error))
        alone.append(error @ np.linalg.solve(built(LM)(noisy, TRUTH).covariance, error))
    # Chi-square of 6 has the mean 6; that of the solver takes pairs as independent.
    assert 3.5 < np.mean(squares) < 9.0
    assert (np.mean(alone) > 12.0) == together


def test_the_stated_deviation_is_more_than_noise_causes_and_less_than_was_known() -> None:
    found, stated = [], []
    for seed in range(16):
        problem = as_measured(pairs(count=300, noise_px=0.7, seed=seed))
        fits = fitted(problem, TRUTH, fits_cameras=False, prior=PRIOR).motions
        found.append([[f.motion.speed_m_s, f.motion.turn_rad_s] for f in fits])
        stated.append([np.sqrt(np.diag(f.covariance)) for f in fits])
    truth = [[m.speed_m_s, m.turn_rad_s] for m in MOTIONS]
    ratio = np.sqrt(np.mean((np.array(found) - truth) ** 2, axis=0)) / np.mean(stated, axis=0)
    assert ((ratio > 0.1) & (ratio < 1.0)).all()
    assert (np.mean(stated, axis=0) < [PRIOR.speed_sigma, PRIOR.turn_sigma]).all()


@pytest.mark.parametrize(
    "values", [(np.nan, 0.0), (0.0, np.inf), (1.0, 0.0, (0.0, 0.0, 0.0)), (1.0, 0.0, (np.nan, 1, 0))]
)
def test_a_motion_that_is_none_is_refused(values: tuple) -> None:
    with pytest.raises(InputError, match="ego-motion is not valid"):
        EgoMotion(*values)


def test_an_expected_motion_needs_deviations() -> None:
    for sigmas in ((0.0, 0.1), (8.0, -1.0)):
        with pytest.raises(InputError, match="not positive"):
            MotionPrior(EgoMotion(), *sigmas)


def test_a_twist_turns_to_the_left_and_sweeps_of_one_drive_may_all_differ_from_the_expected_speed() -> None:
    assert EgoMotion(10.0, 0.0, (0.0, 2.0, 0.0)).twist == pytest.approx([0, 0, 0, 0, 10, 0])
    ahead = moved(EgoMotion(10.0, 0.5).twist, np.array([0.01]), np.array([[20.0, 0.0, 0.0]]))
    # What stays put is behind by what the car went, seen from where it was: the sensor's frame moved on and turned.
    assert ahead[0] == pytest.approx([20.1, 20 * 0.005, 0], abs=2e-3)
    assert se3.distance_m(se3.exp(EgoMotion(10.0, 0.5).twist * 0.01)) == pytest.approx(0.1, abs=1e-3)
    assert PRIOR.covariance_of(1) == pytest.approx(PRIOR.covariance)
    many = PRIOR.covariance_of(50)
    assert np.diag(many) == pytest.approx(np.tile(np.diag(PRIOR.covariance), 50))
    mean = np.kron(np.full((1, 50), 1 / 50), np.eye(2))
    speed, turn = np.sqrt(np.diag(mean @ many @ mean.T))
    assert speed > 0.5 * PRIOR.speed_sigma
    assert turn == pytest.approx(PRIOR.turn_sigma / np.sqrt(50))


# ---- an offset in time

SPEEDS = np.array([[0, 0, 0.0, 14, 0, 0], [0, 0, 0.2, 6, 0, 0], [0, 0, -0.1, 9, 0, 0], [0, 0, 0, 0, 0, 0]])
FOUR = (PINHOLE,) * 4
UNKNOWN = TimeOffset(0.0, 0.05, used=True)


def as_told(problem: PointToLine, twists: np.ndarray, later_s: float) -> PointToLine:
    """Return pairs with the points where they were that long before the image was taken."""
    xyz = np.array(problem.xyz)
    for number, twist in enumerate(twists):
        rows = problem.frame == number
        xyz[rows] = moved(twist, np.full(rows.sum(), later_s), xyz[rows])
    return replace(problem, xyz=xyz)


@pytest.mark.parametrize("later_s", [0.012, -0.03])
def test_exact_pairs_of_several_speeds_tell_the_offset_and_the_pose(later_s: float) -> None:
    problem = as_told(pairs(count=600, cameras=FOUR), SPEEDS, later_s)
    found = fitted(problem, NEAR, fits_cameras=False, twists=SPEEDS, time=UNKNOWN)
    assert found.time.offset_s == pytest.approx(later_s, abs=5e-4)
    assert found.time.sigma_s < 0.005
    assert pose_error(found.camera_from_lidar, TRUTH).translation_m < 0.004
    moved_on = as_told(problem, SPEEDS, -0.01)
    again = fitted(moved_on, NEAR, fits_cameras=False, twists=SPEEDS, time=replace(UNKNOWN, offset_s=0.01))
    assert again.time.offset_s == pytest.approx(found.time.offset_s, abs=1e-4), "of points that are moved already"
    without = fitted(problem, NEAR, fits_cameras=False)
    assert without.time is None
    assert pose_error(without.camera_from_lidar, TRUTH).translation_m > 0.05


def test_one_speed_cannot_be_told_from_a_pose_and_leaves_the_offset_at_zero() -> None:
    same = np.tile([0, 0, 0, 10.0, 0, 0], (4, 1))
    problem = as_told(pairs(count=600, cameras=FOUR), same, 0.02)
    found = fitted(problem, NEAR, fits_cameras=False, twists=same, time=UNKNOWN)
    assert abs(found.time.offset_s) < 1e-3
    assert found.time.sigma_s == pytest.approx(0.05, rel=0.05)


def test_offset_and_motions_are_told_apart() -> None:
    """Two raw sweeps, whose motions are unknown, beside two that were corrected by what is known."""
    twists = np.array([np.zeros(6), np.zeros(6), SPEEDS[0], SPEEDS[1]])
    late = as_told(as_measured(pairs(count=900, cameras=FOUR)), twists, 0.02)
    found = fitted(late, NEAR, fits_cameras=True, prior=PRIOR, twists=twists, time=UNKNOWN)
    assert found.time.offset_s == pytest.approx(0.02, abs=3e-3)
    for fit, true in zip(found.motions[:2], MOTIONS, strict=True):
        assert fit.motion.speed_m_s == pytest.approx(true.speed_m_s, abs=0.5)
    assert pose_error(found.camera_from_lidar, TRUTH).translation_m < 0.01
    assert abs(found.cameras[0].error.focal) < 1e-3


def test_the_stated_deviation_of_an_offset_covers_frames_that_err_each_by_itself() -> None:
    """Each frame is off by 3 cm along the road, as by its place: pairs of one frame then all err alike."""
    errors, stated = [], []
    twists = np.column_stack([np.zeros((8, 3)), np.linspace(2, 16, 8), np.zeros((8, 2))])
    for seed in range(14):
        problem = pairs(count=150, cameras=(PINHOLE,) * 8, seed=seed)
        shift = np.random.default_rng(seed).normal(0, 0.03, 8)[problem.frame]
        off = replace(problem, xyz=problem.xyz + shift[:, None] * [1.0, 0, 0])
        found = fitted(off, TRUTH, fits_cameras=False, twists=twists, time=UNKNOWN).time
        errors.append(found.offset_s)
        stated.append(found.sigma_s)
    ratio = np.sqrt(np.mean(np.square(errors))) / np.mean(stated)
    assert 0.4 < ratio < 1.4
