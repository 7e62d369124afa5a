"""Align points with planes, globally: `--calibrator mirzaei`, after Mirzaei, Kottas and Roumeliotis 2012.

Every point of a board lies in the plane observed by the image. With the translation eliminated, the sum of squared
distances is a polynomial of fourth degree in the quaternion of the rotation. All its minima are found, so no initial
guess is needed, and the least one with the boards in front of both sensors is used; Levenberg-Marquardt refines the
same sum. At least three boards with different orientations are needed (observability analysis of the paper).

Departures: the paper also estimates the intrinsics of the LiDAR's beams, which are given here; it finds the stationary
points by a resultant matrix, here by Newton's method from 72 rotations that cover all rotations within 56 deg. Boards
are detected and paired by the shared package `boards`; those of the paper are marked by hand.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o import Float, se3

from p2o_baselines import examples
from p2o_baselines.boards.board_method import BoardAlgorithm, BoardMethod, same_cost
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.residuals import off_plane
from p2o_baselines.target_method import TargetOptions

_NEWTON_STEPS = 60


def form_of(pairs: Sequence[Pair]) -> tuple[Float, Float]:
    """Return the squares of n . (R p + t) - d as a form (10, 10) of R's entries and 1, and how (3, 10) these give t."""
    gram = np.zeros((13, 13))
    for pair in pairs:
        normal, xyz = pair.board.normal, pair.patch.xyz
        by_turn = (normal[None, :, None] * xyz[:, None, :]).reshape(len(xyz), 9)
        by_shift = np.broadcast_to(normal, xyz.shape)
        rows = np.concatenate([by_turn, np.full((len(xyz), 1), -pair.board.offset_m), by_shift], axis=1)
        gram += rows.T @ rows
    shift = np.asarray(-np.linalg.solve(gram[10:, 10:], gram[10:, :10]))
    return gram[:10, :10] + gram[:10, 10:] @ shift, shift


def minima(form: Float) -> list[tuple[float, Float]]:
    """Return the least values of a form (10, 10) over rotations (3, 3), best first, each once."""
    rotations = _cover()
    damping = np.full(len(rotations), 1e-3)
    value = _value(form, rotations)
    generators = se3.skew(np.eye(3))
    for _ in range(_NEWTON_STEPS):
        entries = np.concatenate([rotations.reshape(-1, 9), np.ones((len(rotations), 1))], axis=1)
        # First and second derivatives by a left turn: of R exp[w]x R, w about the camera's axes.
        first = np.zeros((len(rotations), 3, 10))
        first[..., :9] = (generators @ rotations[:, None]).reshape(-1, 3, 9)
        slope = np.einsum("bai,ij,bj->ba", first, form, entries)
        hessian = np.einsum("bai,ij,bcj->bac", first, form, first)
        pulled = (entries @ form)[:, :9].reshape(-1, 3, 3)
        twice = np.einsum("axy,cyz->acxz", generators, generators)
        twice = 0.5 * (twice + twice.swapaxes(0, 1))
        hessian = hessian + np.einsum("bxw,acxz,bzw->bac", pulled, twice, rotations)
        least = np.linalg.eigvalsh(hessian)[:, 0]
        size = np.trace(hessian, axis1=1, axis2=2)
        # Newton's method also converges to saddles: make the Hessian positive definite.
        shift = np.maximum(damping * np.abs(size), 1e-9 * np.abs(size) - 1.5 * np.minimum(least, 0.0))
        step = -np.linalg.solve(hessian + shift[:, None, None] * np.eye(3), slope[..., None])[..., 0]
        step *= np.minimum(1.0, 0.5 / np.maximum(np.linalg.norm(step, axis=1), 1e-12))[:, None]
        trial = se3.exp(np.concatenate([step, np.zeros_like(step)], axis=1))[:, :3, :3] @ rotations
        tried = _value(form, trial)
        better = tried <= value
        rotations, value = np.where(better[:, None, None], trial, rotations), np.where(better, tried, value)
        damping = np.clip(np.where(better, damping / 5, damping * 5), 1e-12, 1e6)
    out: list[tuple[float, Float]] = []
    for at in np.argsort(value, kind="stable"):
        if not any(np.linalg.norm(rotations[at] - known) < 0.02 for _, known in out):
            out.append((float(value[at]), rotations[at]))
    return out


def _value(form: Float, rotations: Float) -> Float:
    entries = np.concatenate([rotations.reshape(-1, 9), np.ones((len(rotations), 1))], axis=1)
    return np.asarray(np.einsum("bi,ij,bj->b", entries, form, entries))


def _cover() -> Float:
    """Return 72 rotations (72, 3, 3): the 24 of the cube, and each turned by 45 deg two ways."""
    from scipy.spatial.transform import Rotation

    cube = Rotation.create_group("O")
    diagonal = Rotation.from_rotvec(np.radians(45) * np.array([1, 1, 1]) / np.sqrt(3))
    return np.concatenate([cube.as_matrix(), (diagonal * cube).as_matrix(), (diagonal.inv() * cube).as_matrix()])


def closed(pairs: Sequence[Pair], rough: Float) -> Float:
    """Return the pose (4, 4) of the least sum of squares that has the boards before both sensors, and near them."""
    form, by_entries = form_of(pairs)
    best: tuple[float, Float] | None = None
    for value, rotation in minima(form):
        pose = se3.make(rotation, by_entries @ np.r_[rotation.ravel(), 1.0])
        # The normals of both sensors point towards them: a pose that reverses the normals is the mirrored solution.
        faces = all(pose[:3, :3] @ pair.patch.normal @ pair.board.normal > 0 for pair in pairs)
        if faces and (best is None or value < best[0]):
            best = (value, pose)
    return rough if best is None else best[1]


ALGORITHM = BoardAlgorithm(least=3, planes_only=True, closed=closed, cost=same_cost(off_plane))


METHOD = p2o.Method(
    name="mirzaei",
    build=lambda options: BoardMethod(options, ALGORITHM),
    options=TargetOptions,
    summary="Aligns points of checkerboards with planes: all minima of the polynomial, no initial guess needed.",
    needs=frozenset({"targets"}),
    cite="Mirzaei, Kottas and Roumeliotis, 3D LIDAR-camera intrinsic and extrinsic calibration: identifiability and "
    "analytical least-squares-based initialization, IJRR 2012",
    example=examples.checkerboards("0.9deg 0.06m"),
)
