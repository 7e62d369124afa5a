"""Align simultaneous sweeps of two LiDARs by generalised ICP (package small_gicp), over several moments.

Each moment is aligned on its own. The covariance of the mean follows from the scatter over the moments: the Hessian of
generalised ICP neglects that neighbouring points of a ring share their errors, and predicts errors of sparse sweeps
that are several times too small. It contributes its shape only, for directions that few moments do not sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.cloud import Cloud
from p2o.geometry import se3
from p2o.geometry.motion import adjoint_matrix
from p2o.runtime.packages import optional_package

MIN_MOMENTS = 3
"""Minimum number of moments for a scatter."""
_VOXEL_M, _NEIGHBOURS = 0.25, 20
"""Size of voxels, and number of neighbours for normals: with 10, normals of 16 rings follow the rings."""
_REACHES_M = (2.0, 1.0, 0.5)
"""Maximum distances of pairs of points, one after the other."""
_MIN_OVERLAP, _MIN_PAIRS = 0.1, 200
"""Minimum share of the smaller sweep, and minimum number of points, with a partner in the other sweep."""
_MAX_SCATTER_DEG, _MAX_SCATTER_M = 1.0, 0.3
"""Maximum deviation of moments from their centre, as a median."""
_SHAPE_WEIGHT = 6
"""Number of moments that the shape of the Hessian counts as."""
_OUTLIER_QUANTILE = 0.99
_BIAS_DEG, _BIAS_M = 0.03, 0.001
"""Systematic error per axis and per degree between the rings of the sparser sweep, which all moments share: rings of
one sweep attract nearly parallel rings of the other. Measured with simulated sensors (docs/how-to/several-lidars.md).
"""
_MIN_BIAS_DEG, _MIN_BIAS_M = 0.01, 0.002
_WITHOUT_RINGS_DEG = 1.0
"""Distance between rings that a sweep without rings counts as."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """Pose `first_from_second` (4, 4) of two LiDARs, with the covariance (6, 6) of its left update (rad, m).

    `moments` is the number of pairs of sweeps, `used` the number of those without outliers, `overlap` the median share
    of points with a partner.
    """

    first_from_second: Float
    covariance: Float
    moments: int
    used: int
    overlap: float


@dataclass(frozen=True, eq=False)
class _Moment:
    pose: Float
    information: Float
    overlap: float


def align_sweeps(pairs: Sequence[tuple[Cloud, Cloud]], guess: Float) -> Alignment:
    """Estimate first_from_second (4, 4) from pairs of simultaneous sweeps and an initial guess (4, 4).

    Sweeps have to be motion-compensated to the same time, or measured at standstill. Raises MethodUnavailable without
    small_gicp, and InputError if fewer than `MIN_MOMENTS` pairs overlap, or if their alignments scatter too much.
    """
    moments = [moment for pair in pairs if (moment := _aligned(*pair, guess)) is not None]
    if len(moments) < MIN_MOMENTS:
        expected = f"at least {MIN_MOMENTS} pairs of sweeps with {_MIN_OVERLAP:.0%} of their points in common"
        raise InputError("too few sweeps overlap", expected=expected, got=f"{len(moments)} of {len(pairs)}")
    steps, shape, centre = _about_centre(moments)
    turn_deg = float(np.median(np.degrees(np.linalg.norm(steps[:, :3], axis=1))))
    shift_m = float(np.median(np.linalg.norm(steps[:, 3:], axis=1)))
    if turn_deg > _MAX_SCATTER_DEG or shift_m > _MAX_SCATTER_M:
        expected = f"a scatter of at most {_MAX_SCATTER_DEG:g} deg and {_MAX_SCATTER_M:g} m"
        got = f"{turn_deg:.2g} deg and {shift_m:.2g} m"
        hint = "record more places, or a better initial guess"
        raise InputError("the alignments of the moments differ", expected=expected, got=got, hint=hint)
    kept = steps[_inliers(steps, shape)]
    mean = kept.mean(axis=0)
    covariance = _covariance(kept - mean, shape) + _bias(pairs[0])
    overlap = float(np.median([moment.overlap for moment in moments]))
    pose = se3.exp(mean) @ centre
    return Alignment(se3.check_rigid("the alignment", pose), covariance, len(moments), len(kept), overlap)


def _aligned(first: Cloud, second: Cloud, guess: Float) -> _Moment | None:
    """Align one pair of sweeps; None if too few points overlap."""
    small_gicp = optional_package("small_gicp", "the alignment of sweeps", '"p2o-calib[gicp]"')
    target, tree = small_gicp.preprocess_points(first.xyz, _VOXEL_M, _NEIGHBOURS)
    source, _ = small_gicp.preprocess_points(second.xyz, _VOXEL_M, _NEIGHBOURS)
    if min(target.size(), source.size()) < _MIN_PAIRS:
        return None
    pose = guess
    for reach_m in _REACHES_M:
        limits = {"max_iterations": 50, "rotation_epsilon": 1e-5, "translation_epsilon": 1e-5}
        registration = small_gicp.align(target, source, tree, pose, max_correspondence_distance=reach_m, **limits)
        pose = registration.T_target_source
    overlap = registration.num_inliers / min(target.size(), source.size())
    if registration.num_inliers < _MIN_PAIRS or overlap < _MIN_OVERLAP or not np.isfinite(pose).all():
        return None
    pose = np.array(se3.check_rigid("the alignment", pose, tolerance=1e-3))
    # The Hessian is by right updates, in the frame of the second LiDAR.
    to_right = adjoint_matrix(se3.inverse(pose))
    return _Moment(pose, to_right.T @ registration.H @ to_right, overlap)


def _about_centre(moments: Sequence[_Moment]) -> tuple[Float, Float, Float]:
    """Return left updates (N, 6) from a robust centre to each moment, the shape (6, 6) of the scatter, the centre.

    The centre is the moment with the smallest sum of distances to the others (medoid).
    """
    information = np.mean([moment.information for moment in moments], axis=0)
    steps = [[se3.log(moment.pose @ se3.inverse(centre.pose)) for moment in moments] for centre in moments]
    distances = [np.sqrt(np.einsum("ni,ij,nj->n", np.array(row), information, np.array(row))).sum() for row in steps]
    best = int(np.argmin(distances))
    return np.array(steps[best]), np.linalg.inv(information), moments[best].pose


def _inliers(steps: Float, shape: Float) -> np.ndarray:
    """Return the mask (N,) of moments within the scatter of most of them; always more than half."""
    from scipy.stats import chi2

    squares = np.einsum("ni,ni->n", steps, np.linalg.solve(shape, steps.T).T)
    typical = np.sort(squares)[len(squares) // 2] / chi2.median(6)
    return np.asarray(squares <= max(typical, 1.0) * chi2.ppf(_OUTLIER_QUANTILE, 6))


def _covariance(deviations: Float, shape: Float) -> Float:
    """Return the covariance (6, 6) of the mean of deviations (N, 6).

    The scatter is regularised by the shape, scaled to it: the mean of an inverse Wishart distribution.
    """
    count = len(deviations)
    squares = np.einsum("ni,ni->n", deviations, np.linalg.solve(shape, deviations.T).T)
    scale = max(1.0, float(squares.sum()) / (6 * (count - 1)))
    single = (_SHAPE_WEIGHT * scale * shape + deviations.T @ deviations) / (_SHAPE_WEIGHT + count - 1)
    return np.asarray(single / count)


def _bias(pair: tuple[Cloud, Cloud]) -> Float:
    """Return the covariance (6, 6) of the systematic error of a pair of LiDARs."""
    spacing_deg = max(map(_ring_spacing_deg, pair))
    turn_deg, shift_m = max(_MIN_BIAS_DEG, _BIAS_DEG * spacing_deg), max(_MIN_BIAS_M, _BIAS_M * spacing_deg)
    return np.diag(np.repeat([np.radians(turn_deg), shift_m], 3) ** 2)


def _ring_spacing_deg(cloud: Cloud) -> float:
    """Return the median angle between neighbouring rings in degrees."""
    if cloud.ring is None or len(rings := np.unique(cloud.ring)) < 2:
        return _WITHOUT_RINGS_DEG
    xyz = cloud.as_measured()
    elevation = np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))
    return float(np.median(np.diff(np.sort([np.median(elevation[cloud.ring == ring]) for ring in rings]))))
