"""One place of the LiDAR on a rig, from the results of its cameras: information-weighted fusion on SE(3).

The unknown is body_from_lidar. Where a camera's place on the body is known, its result says
inverse(camera_from_body) @ camera_from_lidar, with its own covariance; what all of them say is their mean, each
weighted by the inverse of its covariance (Barfoot, State Estimation for Robotics, 2017, section 7.3). Edges are not
looked at again: this is exact for small errors, and it cannot find a pose that none of the cameras is near.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float
from p2o.calibration.accuracy import deviations, place_by_update
from p2o.errors import InputError
from p2o.geometry import se3
from p2o.geometry.motion import adjoint
from p2o.results.accuracy import Accuracy
from p2o.results.result import Result
from p2o.results.rig import RigCamera, RigResult
from p2o.results.verdict import Doubt, Reason, Verdict

_LEAST_P = 0.01
"""Results that are farther apart than one time in a hundred by chance contradict each other."""
_STEPS, _SMALL = 50, 1e-12
_LEAST_CONDITION = 1e-12
_WIDER = 2.2
"""Nineteen of twenty errors are within so much more than two of three, as for single results."""
OWN_SHARE = 0.25
"""This share of the likely squared error of each axis is its own: edges that are taken for others do not keep to the
mixtures of axes that the noise of pairs leaves open, and without it a few pairs look as if they knew one of them to a
millimetre.
"""


@dataclass(frozen=True, eq=False)
class Opinion:
    """What one camera says: body_from_lidar (4, 4), and the covariance (6, 6) of its left update in the body frame."""

    name: str
    body_from_lidar: Float
    covariance: Float

    @classmethod
    def of(cls, name: str, result: Result, camera_from_body: Float) -> Opinion:
        """Return what a solved result with a covariance says, its size as the likely error has it.

        Raises InputError for a result that is not solved, has no covariance, or one that leaves a direction open.
        """
        if not result.status.solved:
            raise InputError(f"{result.status.value}: {result.reason}")
        if result.covariance is None:
            raise InputError("its result has no covariance")
        # Starts of a rig's cameras often come from one drawing: what they are worth must not count once a camera.
        alone = result if result.start_weight is None else result.start_weight
        covariance = _as_likely(result.covariance, alone.camera_from_lidar, alone.accuracy)
        body_from_camera = se3.inverse(camera_from_body)
        by_update = np.stack([adjoint(body_from_camera, axis) for axis in np.eye(6)], axis=1)
        covariance = by_update @ covariance @ by_update.T
        if not _regular(covariance):
            raise InputError("its covariance is singular")
        return cls(name, body_from_camera @ alone.camera_from_lidar, (covariance + covariance.T) / 2)


@dataclass(frozen=True, eq=False)
class Fusion:
    """The mean (4, 4) of opinions with its covariance (6, 6), and how far they are from it by their covariances."""

    body_from_lidar: Float
    covariance: Float
    chi_square: float

    @classmethod
    def of(cls, opinions: Sequence[Opinion]) -> Fusion:
        """Return the pose at which the weighted steps to all opinions sum to zero; there must be one opinion."""
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
    """Return the common result of cameras by name, given their results and their places (4, 4) on the body.

    Cameras without a result, or with one that has no usable covariance, are left out and told.
    """
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
    cameras = tuple(
        _beside(name, opinions, whole, place, left_out.get(name, "")) for name, place in camera_from_body.items()
    )
    degrees = 6 * (len(opinions) - 1)
    p_value = _p_value(whole.chi_square, degrees)
    # Cameras that are farther apart than they should be are as much less sure than they say (Birge's ratio).
    covariance = whole.covariance * max(1.0, whole.chi_square / degrees)
    rotation_deg, translation_m = deviations(covariance, whole.body_from_lidar)
    trusted = sum(results[opinion.name].verdict.trusted for opinion in opinions)
    return RigResult(
        whole.body_from_lidar,
        f"the mean of {len(opinions)} cameras, weighted by their likely errors",
        Verdict((*_contradiction(cameras, whole.chi_square, degrees, p_value), *_too_few(trusted, len(opinions)))),
        cameras,
        covariance=covariance,
        accuracy=Accuracy(rotation_deg, translation_m, _WIDER * rotation_deg, _WIDER * translation_m),
        chi_square=whole.chi_square,
        degrees=degrees,
        p_value=p_value,
    )


def _as_likely(covariance: Float, camera_from_lidar: Float, accuracy: Accuracy | None) -> Float:
    """Return the covariance (6, 6) whose deviations are the likely errors, where these are known.

    Turns and places of the LiDAR about and along each axis are scaled by factors of their own, as noise of pairs, which
    covariances tell, is a part of real errors only; the rest is each axis's own, so that what one of them leaves open
    widens no other. Where axes are not told apart, turns have one factor, places another.
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
        # As sure by axis as the errors are in all.
        likely = np.array(axes, np.float64) * np.repeat([np.radians(1.0), 1.0], 3)
        likely *= np.repeat(whole / np.linalg.norm(likely.reshape(2, 3), axis=1), 3)
        scale = likely / np.sqrt(np.diag(place @ covariance @ place.T))
    scaled = (scale[:, None] * place) @ covariance @ (scale[:, None] * place).T
    by_update = np.linalg.inv(place)
    return np.asarray(by_update @ ((1 - OWN_SHARE) * scaled + OWN_SHARE * np.diag(likely**2)) @ by_update.T)


def _regular(covariance: Float) -> bool:
    """Return whether a covariance (6, 6) is one of six directions, each with a deviation of its own."""
    if not np.isfinite(covariance).all():
        return False
    values = np.linalg.eigvalsh((covariance + covariance.T) / 2)
    return bool(values[0] > _LEAST_CONDITION * values[-1])


def _beside(name: str, opinions: Sequence[Opinion], whole: Fusion, camera_from_body: Float, left_out: str) -> RigCamera:
    """Return a camera with the step from what all others say together to what it says itself."""
    common = camera_from_body @ whole.body_from_lidar
    own = next((opinion for opinion in opinions if opinion.name == name), None)
    if own is None:
        return RigCamera(name, common, left_out=left_out)
    others = Fusion.of([opinion for opinion in opinions if opinion.name != name])
    step = own.body_from_lidar @ se3.inverse(others.body_from_lidar)
    tangent = se3.log(step)
    chi_square = float(tangent @ np.linalg.solve(own.covariance + others.covariance, tangent))
    moved = se3.inverse(others.body_from_lidar) @ own.body_from_lidar
    return RigCamera(name, common, se3.angle_deg(moved), se3.distance_m(moved), chi_square)


def _p_value(chi_square: float, degrees: int) -> float:
    from scipy.stats import chi2

    return float(chi2.sf(chi_square, degrees))


def _contradiction(cameras: Sequence[RigCamera], chi_square: float, degrees: int, p_value: float) -> list[Reason]:
    """Return a reason where the cameras are farther apart than their likely errors explain."""
    if p_value >= _LEAST_P:
        return []
    worst = max(cameras, key=lambda camera: camera.chi_square or 0.0)
    text = (
        "the results of the cameras contradict the fixed transforms between them (chi-square "
        f"{chi_square:.0f} for {degrees}), most of all {worst.name}, {worst.rotation_deg:.2f} deg and "
        f"{worst.translation_m:.2f} m from the others"
    )
    return [Reason(Doubt.CONTRADICTION, text)]


def _too_few(trusted: int, count: int) -> list[Reason]:
    """Return a reason where fewer than two cameras are trusted by themselves."""
    if trusted >= 2:
        return []
    return [Reason(Doubt.TOO_FEW_CAMERAS, f"{trusted} of {count} cameras are trusted by themselves, and it takes two")]
