"""What is wrong with a camera's calibration, as the edges of both sensors tell it: focal length and distortion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from p2o import se3
from p2o.arrays import Float, Int
from p2o.camera import Camera
from p2o.errors import InputError
from p2o.problem import PointToLine
from p2o.side import Side

_LARGEST = 0.2
_STEP = 1e-6
_ITERATIONS = 30
_PRIOR = np.array([0.01, 0.02])
_CELL_PX = 64.0
_OUTWARD = {Side.LEFT: (-1.0, 0.0), Side.RIGHT: (1.0, 0.0), Side.UPPER: (0.0, -1.0), Side.BOTTOM: (0.0, 1.0)}
_FIRST_RADIAL = {
    "SIMPLE_RADIAL": 3,
    "RADIAL": 3,
    "OPENCV": 4,
    "FULL_OPENCV": 4,
    "SIMPLE_RADIAL_FISHEYE": 3,
    "RADIAL_FISHEYE": 3,
    "OPENCV_FISHEYE": 4,
    "THIN_PRISM_FISHEYE": 4,
}
_FOCAL = {"SIMPLE_RADIAL": 1, "RADIAL": 1, "SIMPLE_RADIAL_FISHEYE": 1, "RADIAL_FISHEYE": 1}
"""How many focal lengths a model has, if not two."""


@dataclass(frozen=True)
class RadialError:
    """An error of a camera's calibration: the true focal length is 1 + `focal` times that of the calibration.

    `radial` is to be added to the first radial coefficient of the camera's model (k1; of distortion as in Brown,
    Close-range camera calibration, 1971, or of the angle for fisheye models). Raises InputError for values that are
    not finite or larger than 0.2, which no calibrated camera has.
    """

    focal: float = 0.0
    radial: float = 0.0

    def __post_init__(self) -> None:
        size = np.abs([self.focal, self.radial])
        if not (np.isfinite(size).all() and size.max() <= _LARGEST):
            raise InputError(
                "the error of the camera's calibration is out of bounds",
                expected=f"focal and radial of at most {_LARGEST}",
                got=f"{self.focal:g}, {self.radial:g}",
            )

    def __bool__(self) -> bool:
        return bool(self.focal or self.radial)

    def corrected(self, camera: Camera) -> Camera:
        """Return the camera without the error; a pinhole becomes an OPENCV camera.

        Raises InputError for a model that has no radial coefficient.
        """
        if not self:
            return camera
        model, params = _radial_model(camera)
        count = _FOCAL.get(model, 2)
        focal = [f * (1 + self.focal) for f in params[:count]]
        params = [*focal, *params[count:]]
        params[_FIRST_RADIAL[model]] += self.radial
        return Camera(model, camera.width, camera.height, tuple(params))

    def seen(self, camera: Camera, uv: Float) -> Float:
        """Return where in the picture (..., 2) px is seen what the calibration puts at pixels (..., 2)."""
        return self.corrected(camera).project(camera.rays(uv))

    def calibrated(self, camera: Camera, uv: Float) -> Float:
        """Return where the calibration puts (..., 2) px what is seen at pixels (..., 2): the inverse of `seen`."""
        return camera.project(self.corrected(camera).rays(uv))

    def shift_px(self, camera: Camera) -> float:
        """Return the largest distance in pixels between where things are seen and where the calibration puts them."""
        uv = _grid(camera)
        return float(np.nanmax(np.linalg.norm(self.seen(camera, uv) - uv, axis=-1), initial=0.0))


def is_correctable(camera: Camera) -> bool:
    """Return whether the camera's model has a radial coefficient, or is a pinhole."""
    return camera.model in ("PINHOLE", "SIMPLE_PINHOLE", *_FIRST_RADIAL)


def _radial_model(camera: Camera) -> tuple[str, list[float]]:
    """Return the model of the camera and its parameters, with a radial coefficient."""
    params = list(camera.params)
    if camera.model == "PINHOLE":
        return "OPENCV", [*params, 0.0, 0.0, 0.0, 0.0]
    if camera.model == "SIMPLE_PINHOLE":
        return "SIMPLE_RADIAL", [*params, 0.0]
    if camera.model in _FIRST_RADIAL:
        return camera.model, params
    raise InputError(
        f"camera model {camera.model} has no radial coefficient",
        expected=", ".join(["PINHOLE", *_FIRST_RADIAL]),
        hint="take pipeline.camera=trust",
    )


def _grid(camera: Camera) -> Float:
    """Return pixels (33, 33, 2) all over the picture."""
    u, v = np.meshgrid(np.linspace(-0.5, camera.width - 0.5, 33), np.linspace(-0.5, camera.height - 0.5, 33))
    return np.stack([u, v], axis=-1)


@dataclass(frozen=True, eq=False)
class RadialFit:
    """The radial error of one `camera` as the pairs tell it, with its covariance (2, 2) of focal and radial."""

    camera: Camera
    error: RadialError
    covariance: Float

    def apart_px(self, other: RadialFit) -> float:
        """Return how far in pixels, at most, this error and another one of the same camera put things apart."""
        focal, radial = self.error.focal - other.error.focal, self.error.radial - other.error.radial
        return RadialError(focal, radial).shift_px(self.camera)

    @property
    def sigma_px(self) -> float:
        """Standard deviation of where things are seen, in pixels, at the place in the picture where it is largest."""
        uv = _grid(self.camera).reshape(-1, 2)
        ray = self.camera.rays(uv)
        ray = ray[np.isfinite(ray).all(axis=1)]
        if not len(ray):
            return float("inf")
        slope = _slopes(self.camera, RadialError(), ray)
        variance = np.einsum("kij,jl,kil->k", slope, self.covariance, slope)
        return float(np.sqrt(np.nanmax(variance, initial=0.0)))


def _slopes(camera: Camera, error: RadialError, xyz: Float) -> Float:
    """Return derivatives (K, 2, 2) of pixels of points (K, 3) by focal and radial error: [k, axis, parameter]."""
    columns = []
    for step in ((_STEP, 0.0), (0.0, _STEP)):
        ahead, behind = (
            RadialError(error.focal + sign * step[0], error.radial + sign * step[1]).corrected(camera).project(xyz)
            for sign in (1, -1)
        )
        columns.append((ahead - behind) / (2 * _STEP))
    return np.stack(columns, axis=-1)


def fit_radial_errors(
    problem: PointToLine, camera_from_lidar: Float, known: Mapping[Camera, RadialError] | None = None
) -> tuple[Float, tuple[RadialFit, ...]]:
    """Return pose (4, 4) and the radial error of every camera that fit the pairs best, all of them together.

    The cameras of `problem` are those of the calibration; `known` are errors to begin from. The robust sum is that of
    the problem (Huber), with the widths of outlines as further unknowns: that both sensors see them a little too wide
    or too narrow must not look like another focal length. Errors are drawn to zero as by a measurement with standard
    deviations of 1 % and 0.02. Their covariance takes pairs of one direction within 64 px as one measurement (cluster
    robust: Liang and Zeger, Longitudinal data analysis using generalized linear models, 1986). Cameras whose model has
    no radial coefficient stay as they are and are not among the fits. Raises InputError for a problem without pairs.
    """
    if not len(problem):
        raise InputError("no pairs to tell an error of the camera from", expected="at least one pair", got="none")
    given = problem.cameras
    distinct = [camera for camera in dict.fromkeys(given) if is_correctable(camera)]
    errors = {camera: (known or {}).get(camera, RadialError()) for camera in distinct}
    number = np.array([distinct.index(c) if c in errors else -1 for c in given])[problem.frame]
    outward = _outward(problem)
    widths = np.zeros(outward.shape[1])
    pose, count = np.asarray(camera_from_lidar, np.float64), 6 + 2 * len(distinct)
    # Slopes by the errors hardly change on the way: taken once.
    fixed = np.hstack([_by_error(problem, pose, errors, number), outward])
    for _ in range(_ITERATIONS):
        rows, residuals = _linearised(problem, pose, errors, fixed)
        residuals = residuals + outward @ widths
        weight = problem.weight * problem.huber_px / np.maximum(np.abs(residuals), problem.huber_px)
        hessian, gradient = (rows * weight[:, None]).T @ rows, rows.T @ (weight * residuals)
        prior = np.zeros(len(hessian))
        prior[6:count] = np.tile(1 / _PRIOR**2, len(distinct))
        state = np.concatenate([np.zeros(6), *([e.focal, e.radial] for e in errors.values()), widths])
        step = -np.linalg.lstsq(hessian + np.diag(prior), gradient + prior * state, rcond=None)[0]
        pose = se3.exp(step[:6]) @ pose
        moved = np.clip(state + step, -0.5 * _LARGEST, 0.5 * _LARGEST)
        errors = {c: RadialError(*moved[6 + 2 * i : 8 + 2 * i].tolist()) for i, c in enumerate(distinct)}
        widths = (state + step)[count:]
        if np.abs(step).max() < 1e-7:
            break
    covariance = _clustered(problem, rows, residuals, np.asarray(np.linalg.pinv(hessian + np.diag(prior))))
    return pose, tuple(
        RadialFit(c, errors[c], covariance[at : at + 2, at : at + 2])
        for c, at in zip(distinct, range(6, count, 2), strict=True)
    )


def _by_error(problem: PointToLine, pose: Float, errors: Mapping[Camera, RadialError], number: Int) -> Float:
    """Return derivatives (K, 2 C) of the residuals by focal and radial of every camera."""
    rows = np.zeros((len(problem), 2 * len(errors)))
    xyz = se3.apply(pose, problem.xyz)
    for i, (camera, error) in enumerate(errors.items()):
        mine = np.flatnonzero(number == i)
        slope = _slopes(camera, error, xyz[mine])
        rows[mine, 2 * i : 2 * i + 2] = np.einsum("ka,kap->kp", problem.normal[mine], slope)
    return rows


def _linearised(
    problem: PointToLine, pose: Float, errors: Mapping[Camera, RadialError], fixed: Float
) -> tuple[Float, Float]:
    """Return derivatives (K, N) of the residuals (K,) by pose and by all else, `fixed`; zero where unseen."""
    cameras = tuple(errors[c].corrected(c) if c in errors else c for c in problem.cameras)
    residuals, by_pose = replace(problem, cameras=cameras).residuals_with_jacobian(pose)
    rows = np.hstack([by_pose, fixed])
    unseen = ~(np.isfinite(residuals) & np.isfinite(rows).all(axis=1))
    return np.where(unseen[:, None], 0.0, rows), np.where(unseen, 0.0, residuals)


def _outward(problem: PointToLine) -> Float:
    """Return how residuals grow (K, W) where outlines are wider and where they are higher; W is 0 without sides."""
    table = np.array([_OUTWARD.get(Side(s), (0.0, 0.0)) for s in range(len(_OUTWARD))])
    known = problem.side >= 0
    if not known.any():
        return np.zeros((len(problem), 0))
    out = np.where(known, (table[np.where(known, problem.side, 0)] * problem.normal).sum(axis=1), 0.0)
    upright = np.isin(problem.side, [Side.LEFT, Side.RIGHT])
    return np.column_stack([out * upright, out * ~upright])


def _clustered(problem: PointToLine, rows: Float, residuals: Float, inverse: Float) -> Float:
    """Return the covariance of all unknowns, pairs of one view, direction and cell of the picture taken as one."""
    cell = np.floor(problem.centre / _CELL_PX).astype(np.int64)
    _, cluster = np.unique(np.column_stack([problem.frame, problem.side, cell]), axis=0, return_inverse=True)
    psi = problem.weight * np.clip(residuals, -problem.huber_px, problem.huber_px)
    score = np.zeros((int(cluster.max()) + 1, rows.shape[1]))
    np.add.at(score, cluster.reshape(-1), rows * psi[:, None])
    return np.asarray(inverse @ (score.T @ score) @ inverse)
