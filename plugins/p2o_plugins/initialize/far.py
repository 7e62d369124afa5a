"""Initializer `far`: search the pose in a given box of many degrees and more than a metre, with one or more frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from p2o import Bool, Float, InitializerBase, Int, Method, Options, View, field, se3
from p2o.solving import SearchBox

from p2o_plugins.initialize.edge_density import DensityAt, EdgeDensity

_SCATTER = 65536  # poses spread over the box, rounded up to a power of two
_KEPT = 2000  # best separate of them that are led uphill
_PROPOSALS = 5  # best ends that are handed on
_MAX_POINTS = 1500  # LiDAR edge points used, evenly thinned over all frames
_MAX_FRAMES = 12  # frames used, evenly taken of a larger group; the others join afterwards


class FarOptions(Options):
    """Options of the far search."""

    reach_deg: float = field(20.0, gt=0, le=60, help="Half size of the box about each axis of the camera.")
    reach_m: float = field(1.5, gt=0, le=10, help="Half size of the box along each axis of the camera.")
    seed: int = field(0, ge=0, help="Seed of the random generator.")


# The search box is slightly enlarged, because rotations and translations depend on the order of composition.
_BEYOND, _FARTHEST = 1.1, 1.4
# Error of the nearest of the poses sampled in the box; then, per refinement: remaining error in deg and m, steps, and
# the fraction of poses that is kept. Tuned on every other frame of KITTI odometry 00.
_SPREAD = (3.0, 0.45)
_CLIMBS = ((2.0, 0.3, 4, 0.5), (1.0, 0.15, 4, 0.15), (0.5, 0.08, 4, 0.02), (0.25, 0.04, 4, 0.005))
# Poses closer than this, in units of the remaining error, are duplicates.
_SEPARATE = 0.7
_DAMPING, _EASED, _STIFFER = 0.03, 0.5, 8.0


@dataclass(frozen=True)
class Far(InitializerBase):
    """The initializer: propose the poses at which the ascents converge, best first, those inside the box before others.

    Poses sampled evenly in the box are scored by the density of image edges at LiDAR edges of their direction, blurred
    by the distance between these poses. The best distinct ones are refined by ascent with decreasing blur, and their
    number is reduced at each stage: near the true pose the score increases more with every step than elsewhere.
    """

    options: FarOptions

    @property
    def reach(self) -> tuple[float, float]:
        """The box of the search."""
        return self.options.reach_deg, self.options.reach_m

    def __call__(self, views: Sequence[View], camera_from_lidar: Float, /) -> list[Float]:
        """Return up to `proposals` poses (4, 4)."""
        options, box = self.options, SearchBox(*self.reach)
        rng = np.random.default_rng(options.seed)
        rows = np.unique(np.linspace(0, len(views) - 1, min(len(views), _MAX_FRAMES)).astype(int))
        chosen = [views[row] for row in rows]
        reachable = [_reachable(view, camera_from_lidar, options, rng) for view in chosen]
        density = EdgeDensity.of(chosen, camera_from_lidar, reachable, _MAX_POINTS)
        if not density.points:
            return [camera_from_lidar]
        moves = _spread(density.at(np.radians(_SPREAD[0]), _SPREAD[1]), options)
        for deg, metres, steps, share in _CLIMBS:
            unit = _unit(deg, metres)
            moves, score = _climbed(density.at(np.radians(deg), metres), moves, unit, steps)
            inside = (np.abs(_tangents(moves)) <= _FARTHEST * _unit(*self.reach)).all(axis=1)
            moves, score = moves[inside], score[inside]
            if not len(moves):
                return [camera_from_lidar]
            most = max(_PROPOSALS, round(share * _KEPT))
            moves = moves[_separate(_tangents(moves) / unit, score, most)]
        poses = [np.asarray(move @ camera_from_lidar) for move in moves]
        poses.sort(key=lambda pose: not box.has(camera_from_lidar, pose))
        return poses[:_PROPOSALS]


def _unit(deg: float, metres: float) -> Float:
    """Return a size of rotations and translations as one of each of the six parameters (6,), rad and m."""
    return np.repeat([np.radians(deg), metres], 3)


def _moves(tangents: Float) -> Float:
    """Return transforms (N, 4, 4) of the camera frame from rotation vectors and translations (N, 6)."""
    moves = se3.exp(np.concatenate([tangents[:, :3], np.zeros((len(tangents), 3))], axis=1))
    moves[:, :3, 3] = tangents[:, 3:]
    return moves


def _tangents(moves: Float) -> Float:
    """Return rotation vectors and translations (N, 6) of transforms (N, 4, 4)."""
    from scipy.spatial.transform import Rotation

    return np.concatenate([Rotation.from_matrix(moves[:, :3, :3]).as_rotvec(), moves[:, :3, 3]], axis=1)


def _reachable(view: View, start: Float, options: FarOptions, rng: np.random.Generator) -> Bool:
    """Return a mask of the LiDAR edges that project into the image at some pose on the boundary of the box."""
    walls = rng.choice([-1.0, 0.0, 1.0], (60, 6)) * _unit(options.reach_deg, options.reach_m)
    seen = np.zeros(len(view.cloud_edges), np.bool_)
    for move in _moves(walls):
        seen |= view.camera.in_image(view.camera.project(se3.apply(move @ start, view.cloud_edges.xyz)))
    return seen


def _spread(score: DensityAt, options: FarOptions) -> Float:
    """Return the best distinct transforms (N, 4, 4) of samples that fill the box evenly."""
    from scipy.stats import qmc

    power = int(np.ceil(np.log2(_SCATTER)))
    even = qmc.Sobol(6, scramble=True, seed=options.seed).random_base2(power)
    tangents = (2.0 * even - 1.0) * _BEYOND * _unit(options.reach_deg, options.reach_m)
    parts = np.array_split(tangents, -(-len(tangents) // 4096))
    scores = np.concatenate([score(_moves(part)) for part in parts])
    return _moves(tangents[_separate(tangents / _unit(*_SPREAD), scores, _KEPT)])


def _separate(places: Float, score: Float, most: int) -> Int:
    """Return the rows of up to `most` best of places (N, 6), without duplicates of a better one."""
    # Candidates below this rank are not evaluated, to limit the run time.
    order = np.argsort(-score, kind="stable")[: 6 * most]
    places, alive, chosen = places[order], np.ones(len(order), np.bool_), []
    for i in range(len(order)):
        if alive[i]:
            chosen.append(order[i])
            if len(chosen) == most:
                break
            alive &= np.square(places - places[i]).sum(axis=1) > _SEPARATE**2
    return np.array(chosen)


def _climbed(score: DensityAt, moves: Float, unit: Float, steps: int) -> tuple[Float, Float]:
    """Return transforms (N, 4, 4) and scores after damped ascent steps (Levenberg, Marquardt), none over `unit`."""
    damping = np.full(len(moves), _DAMPING)
    value, gradient, curvature = score.normal_equations(moves)
    for _ in range(steps):
        diagonal = np.einsum("kii->ki", curvature)
        # Unobservable directions are damped: a step of one unit costs a small part of the score.
        stiffness = _DAMPING * np.maximum(value, 1.0)[:, None] / unit**2
        firm = curvature + (damping[:, None] * diagonal + stiffness)[:, :, None] * np.eye(6)
        step = np.linalg.solve(firm, gradient[:, :, None])[:, :, 0]
        step /= np.maximum(1.0, np.abs(step / unit).max(axis=1))[:, None]
        tried = _moves(step) @ moves
        tried_value, tried_gradient, tried_curvature = score.normal_equations(tried)
        better = tried_value > value
        moves = np.where(better[:, None, None], tried, moves)
        value = np.where(better, tried_value, value)
        gradient = np.where(better[:, None], tried_gradient, gradient)
        curvature = np.where(better[:, None, None], tried_curvature, curvature)
        damping *= np.where(better, _EASED, _STIFFER)
    return moves, value


METHOD = Method(
    name="far",
    build=Far,
    options=FarOptions,
    summary="Whole box of 20 deg and 1.5 m: densities of edges, then many climbs (far starts).",
    needs={"image-edges", "cloud-edges"},
)
