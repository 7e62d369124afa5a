"""Estimate the pose of the LiDAR on a rig from the results of its cameras: information-weighted fusion on SE(3).

The unknown is body_from_lidar. If the pose of a camera on the body is known, its result gives
inverse(camera_from_body) @ camera_from_lidar, with its own covariance; the fused pose is the mean of these poses, each
weighted by the inverse of its covariance (Barfoot, State Estimation for Robotics, 2017, section 7.3). The edges are not
evaluated again: fusion is exact for small errors and cannot find a pose that is far from every camera's result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.motion import adjoint_matrix
from p2o.geometry.pose_error import deviations, place_by_update
from p2o.results.evidence import Accuracy
from p2o.results.result import Result, RigCamera, RigResult
from p2o.results.verdict import Doubt, Reason, Verdict

_LEAST_P = 0.01
"""Results contradict each other if the p-value of the chi-square test is below this value."""
_STEPS, _SMALL = 50, 1e-12
_LEAST_CONDITION = 1e-12
WIDER = 2.2
"""Ratio of the 95 % error bound to the 67 % error bound, the same as for single results."""
OWN_SHARE = 0.25
"""Share of the predicted variance of each axis that is not correlated with other axes. Wrong matches cause errors
outside the unobservable directions of the pair noise; without this share, a few pairs would yield a standard deviation
of a millimetre for some directions.
"""


@dataclass(frozen=True, eq=False)
class Opinion:
    """Pose body_from_lidar (4, 4) from one camera, and the covariance (6, 6) of its left update in the body frame."""

    name: str
    body_from_lidar: Float
    covariance: Float

    @classmethod
    def of(cls, name: str, result: Result, camera_from_body: Float) -> Opinion:
        """Convert a solved result to the body frame, its covariance scaled to the predicted error.

        Raises InputError if the result is not solved, has no covariance or has a singular covariance.
        """
        if not result.status.solved:
            raise InputError(f"{result.status.value}: {result.reason}")
        if result.covariance is None:
            raise InputError("its result has no covariance")
        # The initial guesses of a rig often share one source, so their weight must not count once for each camera.
        alone = result if result.start_weight is None else result.start_weight
        covariance = _as_likely(result.covariance, alone.camera_from_lidar, alone.accuracy)
        body_from_camera = se3.inverse(camera_from_body)
        by_update = adjoint_matrix(body_from_camera)
        covariance = by_update @ covariance @ by_update.T
        covariance = (covariance + covariance.T) / 2
        values = np.linalg.eigvalsh(covariance) if np.isfinite(covariance).all() else np.zeros(1)
        if not values[0] > _LEAST_CONDITION * values[-1]:
            raise InputError("its covariance is singular")
        return cls(name, body_from_camera @ alone.camera_from_lidar, covariance)


@dataclass(frozen=True, eq=False)
class Fusion:
    """Mean pose (4, 4) of opinions, its covariance (6, 6), and the chi-square of the opinions about it."""

    body_from_lidar: Float
    covariance: Float
    chi_square: float

    @classmethod
    def of(cls, opinions: Sequence[Opinion]) -> Fusion:
        """Compute the pose at which the weighted steps to all opinions sum to zero; at least one is required."""
        weights = [np.linalg.inv(opinion.covariance) for opinion in opinions]
        covariance = np.linalg.inv(np.sum(weights, axis=0))
        pose = opinions[0].body_from_lidar
        for _ in range(_STEPS):
            steps = [se3.log(opinion.body_from_lidar @ se3.inverse(pose)) for opinion in opinions]
            mean = covariance @ np.sum([w @ step for w, step in zip(weights, steps, strict=True)], axis=0)
            pose = se3.exp(mean) @ pose
            if np.abs(mean).max() < _SMALL:
                break
        steps = [se3.log(opinion.body_from_lidar @ se3.inverse(pose)) for opinion in opinions]
        chi_square = sum(float(step @ w @ step) for w, step in zip(weights, steps, strict=True))
        return cls(se3.check_rigid("the mean", pose), covariance, chi_square)


def rig_result(results: Mapping[str, Result], camera_from_body: Mapping[str, Float]) -> RigResult:
    """Fuse the results of cameras by name, given their poses camera_from_body (4, 4).

    Cameras without a result, or without a usable covariance, are excluded and reported with the cause.
    """
    from scipy.stats import chi2

    opinions, left_out = [], {}
    for name, place in camera_from_body.items():
        if name not in results:
            left_out[name] = "it has no result"
            continue
        try:
            opinions.append(Opinion.of(name, results[name], place))
        except InputError as problem:
            left_out[name] = problem.what
    if len(opinions) < 2:
        cameras = tuple(RigCamera(name, left_out=left_out.get(name, "")) for name in camera_from_body)
        text = f"{len(opinions)} of {len(camera_from_body)} cameras have a pose with a covariance, and it takes two"
        return RigResult(None, text, Verdict((Reason(Doubt.NOT_SOLVED, text),)), cameras)
    whole = Fusion.of(opinions)
    cameras = tuple(_beside(n, opinions, whole, place, left_out.get(n, "")) for n, place in camera_from_body.items())
    degrees = 6 * (len(opinions) - 1)
    p_value = float(chi2.sf(whole.chi_square, degrees))
    # If the results scatter more than their covariances predict, inflate the covariance (Birge ratio).
    covariance = whole.covariance * max(1.0, whole.chi_square / degrees)
    rotation_deg, translation_m = deviations(covariance, whole.body_from_lidar)
    whose, other = "the results of the cameras", "the others"
    reasons = contradictions(cameras, whole.chi_square, degrees, p_value, whose=whose, other=other)
    trusted = sum(results[opinion.name].verdict.trusted for opinion in opinions)
    if trusted < 2:
        text = f"{trusted} of {len(opinions)} cameras are trusted on their own, and it takes two"
        reasons.append(Reason(Doubt.TOO_FEW_CAMERAS, text))
    return RigResult(
        whole.body_from_lidar,
        f"the mean of {len(opinions)} cameras, weighted by their predicted errors",
        Verdict(tuple(reasons)),
        cameras,
        covariance=covariance,
        accuracy=Accuracy(rotation_deg, translation_m, WIDER * rotation_deg, WIDER * translation_m),
        chi_square=whole.chi_square,
        degrees=degrees,
        p_value=p_value,
    )


def _as_likely(covariance: Float, camera_from_lidar: Float, accuracy: Accuracy | None) -> Float:
    """Scale a covariance (6, 6) so that its standard deviations equal the predicted errors, if these are known.

    Rotation and translation of each axis of the LiDAR have separate factors (one each if errors by axis are unknown);
    the remainder is added to the diagonal, so that an unobservable direction does not widen the others.
    """
    if accuracy is None:
        return covariance
    rotation_deg, translation_m = deviations(covariance, camera_from_lidar)
    if not (rotation_deg > 0 and translation_m > 0):
        return covariance
    place = place_by_update(camera_from_lidar)
    whole = np.array([np.radians(accuracy.rotation_deg), accuracy.translation_m])
    axes = (accuracy.pitch_deg, accuracy.yaw_deg, accuracy.roll_deg, accuracy.x_m, accuracy.y_m, accuracy.z_m)
    if None in axes:
        scale = np.repeat(whole / [np.radians(rotation_deg), translation_m], 3)
        likely = np.repeat(whole / np.sqrt(3), 3)
    else:
        # Scale the errors of the axes so that their norm equals the total predicted error.
        likely = np.array(axes, np.float64) * np.repeat([np.radians(1.0), 1.0], 3)
        likely *= np.repeat(whole / np.linalg.norm(likely.reshape(2, 3), axis=1), 3)
        scale = likely / np.sqrt(np.diag(place @ covariance @ place.T))
    scaled = (scale[:, None] * place) @ covariance @ (scale[:, None] * place).T
    by_update = np.linalg.inv(place)
    return np.asarray(by_update @ ((1 - OWN_SHARE) * scaled + OWN_SHARE * np.diag(likely**2)) @ by_update.T)


def _beside(name: str, opinions: Sequence[Opinion], whole: Fusion, camera_from_body: Float, left_out: str) -> RigCamera:
    """Compare the pose of a camera with the fusion of all other cameras."""
    common = camera_from_body @ whole.body_from_lidar
    own = next((opinion for opinion in opinions if opinion.name == name), None)
    if own is None:
        return RigCamera(name, common, left_out=left_out)
    others = Fusion.of([opinion for opinion in opinions if opinion.name != name])
    return compared(own, others.body_from_lidar, others.covariance, common)


def compared(own: Opinion, body_from_lidar: Float, covariance: Float, camera_from_lidar: Float) -> RigCamera:
    """Compare the own result of a camera with a pose (4, 4) on the body that has a covariance (6, 6).

    `camera_from_lidar` (4, 4) is the one that follows from the common result.
    """
    tangent = se3.log(own.body_from_lidar @ se3.inverse(body_from_lidar))
    chi_square = float(tangent @ np.linalg.solve(own.covariance + covariance, tangent))
    moved = se3.inverse(body_from_lidar) @ own.body_from_lidar
    return RigCamera(own.name, camera_from_lidar, se3.angle_deg(moved), se3.distance_m(moved), chi_square)


def contradictions(
    cameras: Sequence[RigCamera], chi_square: float, degrees: int, p_value: float, *, whose: str, other: str
) -> list[Reason]:
    """Return a reason if the results of cameras differ from the `other` pose by more than their predicted errors.

    `whose` are the results in words.
    """
    if p_value >= _LEAST_P:
        return []
    worst = max(cameras, key=lambda camera: camera.chi_square or 0.0)
    text = (
        f"{whose} contradict the fixed transforms between the cameras (chi-square {chi_square:.0f} for {degrees}), "
        f"most of all {worst.name}, {worst.rotation_deg:.2f} deg and {worst.translation_m:.2f} m from {other}"
    )
    return [Reason(Doubt.CONTRADICTION, text)]
