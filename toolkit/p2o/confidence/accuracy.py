"""Predict the error of a pose from its error budget (scatter of pairs, edge bias of the beam spacing) and agreement."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from p2o.arrays import Float
from p2o.confidence.fusion import OWN_SHARE, Fusion, Opinion
from p2o.features.side import SIDES, Side
from p2o.geometry.pose_error import place_by_update
from p2o.problems.point_to_line import PointToLine
from p2o.results.evidence import Accuracy, Agreement, Rival

_MIN_DEPTH_M = 0.1
MIN_LEAD_EDGES = 1.5
"""Another pose that loses fewer matched edges than this fits as well as the best one."""


@dataclass(frozen=True, eq=False)
class ErrorBudget:
    """Components of the error of a pose, covariances (6, 6) of a left update in rad and m unless stated otherwise.

    `pairs` is that of the scatter of pairs (`p2o.calibration.adjustment`). `beams` is for a common shift of the edges
    of a direction by their gap between beams, `objects` for one by 1 m (`shift_covariance`), `rings` (6,) as of
    `ring_gaps`. `cameras` is the covariance by unnoticed errors of the intrinsics, `absorbed` that by significant ones
    (`p2o.calibration.intrinsics`), of which no factor is needed. `views` is the number of different views. `intervals`
    states that the pose is that of the interval likelihood: another error model.
    """

    pairs: Float
    beams: Float
    objects: Float
    rings: Float
    cameras: Float = field(default_factory=lambda: np.zeros((6, 6)))
    absorbed: Float = field(default_factory=lambda: np.zeros((6, 6)))
    views: float = 1.0
    intervals: bool = False

    @classmethod
    def of(cls, pairs: Float, problem: PointToLine, camera_from_lidar: Float, views: float) -> ErrorBudget:
        """Return the budget of a pose (4, 4) with the pairs of `problem`, which come from `views` different views.

        Outlines of other scenes lie elsewhere between the rings: the error by rings falls with the root of `views`
        (`p2o.problems.distinct_views`).
        """
        views = max(views, 1.0)
        rings = ring_gaps(problem, camera_from_lidar) / np.sqrt(views)
        beams = shift_covariance(problem, camera_from_lidar, problem.sigma_px)
        return cls(pairs, beams, _object_covariance(problem, camera_from_lidar), rings, views=views)

    @classmethod
    def of_intervals(
        cls, covariance: Float, problem: PointToLine, camera_from_lidar: Float, views: float
    ) -> ErrorBudget:
        """Return the budget of a pose (4, 4) by its interval likelihood, from the scatter of outlines (6, 6).

        It contains the error by the position of outlines between beams. `problem` holds the pairs at the pose.
        """
        objects = _object_covariance(problem, camera_from_lidar)
        return cls(covariance, np.zeros((6, 6)), objects, np.zeros(6), views=max(views, 1.0), intervals=True)

    @property
    def model(self) -> ErrorModel:
        """The error model that was fitted to results of this kind."""
        return INTERVAL_ERROR_MODEL if self.intervals else DEFAULT_ERROR_MODEL


def ring_gaps(problem: PointToLine, camera_from_lidar: Float) -> Float:
    """Return the rotation in rad and shift in m (6,) of a pose for an edge error of half a gap between beams.

    Pitch and y by horizontal edges, yaw and x by vertical ones, roll by the worse of both; x and y at the harmonic mean
    of the depths. Unlike in `shift_covariance` the weight of such edges does not matter. It is that of one view.
    """
    depth_m = (problem.xyz @ camera_from_lidar[:3, :3].T + camera_from_lidar[:3, 3])[:, 2]
    focal_px = np.array([camera.focal_px for camera in problem.cameras])[problem.frame]
    near = depth_m > _MIN_DEPTH_M
    if not near.any():
        return np.zeros(6)
    level = np.abs(problem.normal[:, 1]) > np.abs(problem.normal[:, 0])
    angle = problem.sigma_px / focal_px
    upright_rad, level_rad = (
        float(np.median(angle[rows & near])) if (rows & near).any() else 0.0 for rows in (~level, level)
    )
    harmonic_m = 1.0 / float(np.mean(1.0 / depth_m[near]))
    turns = (level_rad, upright_rad, max(level_rad, upright_rad))
    gaps = np.array([*turns, upright_rad * harmonic_m, level_rad * harmonic_m, 0.0])
    return np.asarray(gaps)


def _object_covariance(problem: PointToLine, camera_from_lidar: Float) -> Float:
    """Return the covariance (6, 6) for a shift of the edges of a direction by 1 m, whatever their distance.

    Outlines of near objects dominate it: beams of a finite width widen them by the same length in every frame.
    """
    depth_m = (problem.xyz @ camera_from_lidar[:3, :3].T + camera_from_lidar[:3, 3])[:, 2]
    focal_px = np.array([camera.focal_px for camera in problem.cameras])[problem.frame]
    return shift_covariance(problem, camera_from_lidar, focal_px / np.maximum(depth_m, _MIN_DEPTH_M))


def shift_covariance(problem: PointToLine, camera_from_lidar: Float, shift_px: Float) -> Float:
    """Return the covariance (6, 6) of a left update in rad and m for a common shift of the edges of a direction.

    A shift of all edges of one direction by `shift_px` (K,) moves the pose by its least-squares solution; directions
    are independent. Pairs without a direction are shifted sideways, and up or down. The position of an outline between
    two beams is such a shift: it has the same error for all edges of one direction.
    """
    if not len(problem):
        return np.zeros((6, 6))
    residuals, rows = problem.residuals_with_jacobian(camera_from_lidar)
    visible = np.isfinite(residuals) & np.isfinite(rows).all(axis=1)
    residuals, rows = np.where(visible, residuals, 0.0), np.where(visible[:, None], rows, 0.0)
    weight = problem.weight * problem.huber_px / np.maximum(np.abs(residuals), problem.huber_px)
    inverse = np.linalg.pinv((rows * weight[:, None]).T @ rows)
    shift = (weight * shift_px)[:, None] * rows
    shifts = [(Side.NONE, (1, 0)), (Side.NONE, (0, 1)), *((side, side.background) for side in SIDES)]
    gradients = [np.where(problem.side == side, problem.normal @ np.array(to), 0.0) @ shift for side, to in shifts]
    moved = np.stack(gradients) @ inverse
    return np.asarray(moved.T @ moved)


Z_67 = 0.967
"""Two thirds of the values of a Gaussian lie within this many standard deviations."""


class ErrorModel(NamedTuple):
    """Model of the predicted error: a sum of covariances, and factors from its deviations to bounds.

    `pairs` scales the standard deviation from the scatter of pairs, at an odds ratio of 10, and falls with the power
    `by_odds` of it. `beams` scales the deviation by a common shift of all edges, `rings` the error of half a gap
    between beams (`ring_gaps`); `object_m` is the deviation of a common shift of all outlines of a direction.
    `view_deg` and `view_m` are the error of one view that pairs do not show (mismatches of a scene), which falls with
    the root of the number of views; `floor_deg` and `floor_m` that of any number. `rotation` and `translation` are the
    factors of the 67 % and 95 % bounds, in total and by axis; `axis` is the one that suits the errors of all axes
    together, for sums with other estimates. Where the strength of the agreement is below `strong`, all deviations are
    wider by the power `by_strength` of their ratio: with little evidence, more of the pairs are mismatches.
    """

    pairs: float
    by_odds: float
    beams: float
    rings: float
    object_m: float
    view_deg: float
    view_m: float
    floor_deg: float
    floor_m: float
    rotation: tuple[float, float]
    translation: tuple[float, float]
    axis: float
    strong: float
    by_strength: float

    def inflation(self, agreement: Agreement) -> float:
        """Return the factor of all deviations for weak agreement in few independent cells; 1 where it is strong."""
        strength = max(float(np.nan_to_num(agreement.strength, nan=0.0)), _MIN_STRENGTH)
        return float(max(1.0, self.strong / strength) ** self.by_strength)


DEFAULT_ERROR_MODEL = ErrorModel(
    pairs=0.96,
    by_odds=0.48,
    beams=1.1,
    rings=0.63,
    object_m=0.01,
    view_deg=0.049,
    view_m=0.0097,
    floor_deg=0.019,
    floor_m=0.0068,
    rotation=(1.19, 3.22),
    translation=(1.23, 1.91),
    axis=1.19,
    strong=17.0,
    by_strength=1.5,
)
INTERVAL_ERROR_MODEL = ErrorModel(
    pairs=0.99,
    by_odds=0.0,
    beams=0.0,
    rings=0.0,
    object_m=0.01,
    view_deg=0.049,
    view_m=0.0094,
    floor_deg=0.019,
    floor_m=0.0067,
    rotation=(1.37, 2.76),
    translation=(1.23, 3.67),
    axis=1.04,
    strong=17.0,
    by_strength=1.4,
)
"""Fitted by `python benchmarks/left_out.py fit`: docs/benchmarks.md, The error model. The likelihood of
intervals contains the error by the position of outlines between beams; odds ratios of long intervals are small.
"""
_MIN_ODDS, _MAX_ODDS = 1.5, 40.0
"""The range of odds ratios in the fit; beyond it the model is constant."""
_MIN_STRENGTH = 4.0


def likely_accuracy(
    budget: ErrorBudget, camera_from_lidar: Float, agreement: Agreement, model: ErrorModel | None = None
) -> Accuracy:
    """Return the predicted error of a pose (4, 4) from its error budget and the agreement of edges at it.

    The scatter of pairs shows their noise but not systematic mismatches: the error is a multiple of it that falls with
    the odds ratio of the agreement.
    """
    model = budget.model if model is None else model
    return accuracy_of(likely_covariance(budget, camera_from_lidar, agreement, model), model)


def accuracy_of(covariance: Float, model: ErrorModel) -> Accuracy:
    """Return the predicted error of a pose from the covariance (6, 6) of its errors (`likely_covariance`).

    The square of the total (67 %) is the sum of the squares of its axes.
    """
    axes = np.sqrt(np.diag(covariance))
    rotation_deg, translation_m = float(np.degrees(np.linalg.norm(axes[:3]))), float(np.linalg.norm(axes[3:]))
    bounds = [
        (factor * rotation_deg, other * translation_m)
        for factor, other in zip(model.rotation, model.translation, strict=True)
    ]
    pitch, yaw, roll = (model.rotation[0] * np.degrees(axes[:3])).tolist()
    x, y, z = (model.translation[0] * axes[3:]).tolist()
    return Accuracy(*bounds[0], *bounds[1], roll, pitch, yaw, x, y, z)


def predicted_covariance(likely: Float, camera_from_lidar: Float, model: ErrorModel) -> Float:
    """Return the covariance (6, 6) of a left update in rad and m whose deviations are the predicted errors (67 %).

    `likely` (6, 6) is that of `likely_covariance` at a pose (4, 4).
    """
    scale = np.repeat([model.rotation[0], model.translation[0]], 3)
    by_place = np.linalg.inv(place_by_update(camera_from_lidar)) * scale
    covariance = by_place @ likely @ by_place.T
    return np.asarray(0.5 * (covariance + covariance.T))


def likely_covariance(
    budget: ErrorBudget, camera_from_lidar: Float, agreement: Agreement, model: ErrorModel | None = None
) -> Float:
    """Return the predicted covariance (6, 6): rotations about the camera axes in rad, positions of the LiDAR in m.

    It is a sum of covariances: a direction that one component does not constrain is widened, and no other.
    """
    model = budget.model if model is None else model
    odds = float(np.clip(np.nan_to_num(agreement.odds_ratio, nan=0.0), _MIN_ODDS, _MAX_ODDS))
    floor = np.square([np.radians(model.floor_deg), model.floor_m])
    view = np.square([np.radians(model.view_deg), model.view_m]) / budget.views
    own = np.repeat(floor + view, 3) + (model.rings * budget.rings) ** 2
    scale = model.pairs * (odds / 10.0) ** -model.by_odds
    scatter = scale**2 * budget.pairs + model.beams**2 * budget.beams
    scatter = scatter + model.object_m**2 * budget.objects + budget.cameras
    by_update = place_by_update(camera_from_lidar)
    likely = model.inflation(agreement) ** 2 * np.asarray(by_update @ scatter @ by_update.T + np.diag(own))
    return plus_known(likely, budget.absorbed, camera_from_lidar, model)


def plus_known(likely: Float, known: Float, camera_from_lidar: Float, model: ErrorModel) -> Float:
    """Return a predicted covariance (6, 6) with that of errors of a known size: `known` (6, 6), of a left update.

    Bounds are factors times deviations; errors of a known size need none.
    """
    bounds = np.repeat([model.rotation[0], model.translation[0]], 3)
    by_update = place_by_update(camera_from_lidar)
    return np.asarray(likely + by_update @ known @ by_update.T / np.outer(bounds, bounds))


def fits_as_well(rival: Rival) -> bool:
    """Return whether another pose has about the same cost as the best one; only leads in edges have a bound."""
    return rival.unit == "edges" and rival.lead < MIN_LEAD_EDGES


def or_rival(accuracy: Accuracy, rival: Rival | None) -> Accuracy:
    """Return the accuracy with 95 % bounds that include a rival pose of about the same cost."""
    if rival is None or not fits_as_well(rival):
        return accuracy
    rotation_deg = max(accuracy.rotation_deg_95, rival.rotation_deg)
    return replace(
        accuracy, rotation_deg_95=rotation_deg, translation_m_95=max(accuracy.translation_m_95, rival.translation_m)
    )


_MOST_CHI_SQUARE = 16.81
"""Bound of the chi-square (six degrees of freedom, 1 %) above which edges contradict the initial guess."""


def with_start(
    pose: Float, likely: Float, start: Float, sigma: tuple[float, float], model: ErrorModel
) -> tuple[Float, Float] | None:
    """Return the information-weighted mean of the pose (4, 4) of the edges and the initial guess (4, 4).

    `likely` (6, 6) is the covariance of the errors of the pose by `model` (`likely_covariance`), returned also for the
    mean; `sigma` the standard deviation of the initial guess about (deg) and along (m) each axis. None if a covariance
    is singular or if edges and prior contradict each other, because the stated prior is then too narrow.
    """
    if not np.isfinite(likely).all():
        return None
    # A share of the variance is uncorrelated between axes (p2o.confidence.fusion).
    real = (model.axis / Z_67) ** 2
    edges = real * ((1 - OWN_SHARE) * likely + OWN_SHARE * np.diag(np.diag(likely)))
    prior = np.diag(np.repeat([np.radians(sigma[0]), sigma[1]], 3) ** 2)
    try:
        fusion = Fusion.of([_opinion("edges", pose, edges), _opinion("start", start, prior)])
    except np.linalg.LinAlgError:
        return None
    if not fusion.chi_square <= _MOST_CHI_SQUARE:
        return None
    by_update = place_by_update(fusion.body_from_lidar)
    return fusion.body_from_lidar, np.asarray(by_update @ fusion.covariance @ by_update.T) / real


def _opinion(name: str, camera_from_lidar: Float, covariance: Float) -> Opinion:
    """Return a pose with the covariance (6, 6) of its turn and place as one with that of its left update."""
    by_place = np.linalg.inv(place_by_update(camera_from_lidar))
    return Opinion(name, camera_from_lidar, by_place @ covariance @ by_place.T)
