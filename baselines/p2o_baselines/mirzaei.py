"""Points on planes, solved for all poses at once, `--calibrator mirzaei`, after Mirzaei, Kottas and Roumeliotis 2012.

    p2o run --data folder:BOARDS --joint --calibrator mirzaei

Every point of a board lies in the plane that its picture gives. The sum of squared distances is, with the translation
solved for, a polynomial of fourth degree in the rotation's quaternion. All its minima are found, so no start is
needed, and the least one that has the boards before both sensors is taken; Levenberg and Marquardt finish on the same
sum. At least three boards that face different ways are needed, as the paper's analysis of what can be told says.

Departures: the paper also tells the intrinsics of the LiDAR's beams, which here are the sensor's own; it finds the
stationary points by a resultant matrix, here they are the ends of Newton's method from 72 rotations, which cover all
of them within 56 deg. Boards are found and paired by the shared room `boards`: the paper's are marked by hand.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Block, Cost
from p2o_baselines.boards.board_method import BoardMethod, Way
from p2o_baselines.boards.pairing import Pair
from p2o_baselines.boards.point_to_plane import off_plane
from p2o_baselines.boards.sight import BoardOptions

_NEWTON_STEPS = 60


def form_of(pairs: Sequence[Pair]) -> tuple[Float, Float]:
    """Return the sum of squares as a form (10, 10) of the rotation's entries and 1, and how (3, 10) these give t.

    A residual is n . (R p + t) - d, linear in R's nine entries (row by row) and in t.
    """
    gram = np.zeros((13, 13))
    for pair in pairs:
        normal, xyz = pair.board.normal, pair.patch.xyz
        by_turn = (normal[None, :, None] * xyz[:, None, :]).reshape(len(xyz), 9)
        by_shift = np.broadcast_to(normal, xyz.shape)
        rows = np.concatenate([by_turn, np.full((len(xyz), 1), -pair.board.offset_m), by_shift], axis=1)
        gram += rows.T @ rows
    shift = -np.linalg.solve(gram[10:, 10:], gram[10:, :10])
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
        twice = 0.5 * (
            np.einsum("axy,cyz->acxz", generators, generators) + np.einsum("cxy,ayz->acxz", generators, generators)
        )
        hessian = hessian + np.einsum("bxw,acxz,bzw->bac", pulled, twice, rotations)
        least = np.linalg.eigvalsh(hessian)[:, 0]
        size = np.trace(hessian, axis1=1, axis2=2)
        # Newton goes to saddles too: what is not convex is made so.
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
        # The normals of both sensors look at them: a pose that turns them round is the mirror's.
        faces = all(pose[:3, :3] @ pair.patch.normal @ pair.board.normal > 0 for pair in pairs)
        if faces and (best is None or value < best[0]):
            best = (value, pose)
    return rough if best is None else best[1]


def misfits(pair: Pair, pose: Float) -> Block:
    """Return the distances of points from their plane."""
    return off_plane(pair, pose)


def cost(pairs: Sequence[Pair], pose: Float) -> Cost:
    """Return the sum of squares of the paper."""
    del pairs, pose
    return misfits


WAY = Way(least=3, planes_only=True, closed=closed, cost=cost)


def build(options: BoardOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return BoardMethod(options, WAY)


_BOARDS = "targets=checkerboard&place=yard&frames_per_scene=5&width_px=621&height_px=350&right=false&lidar=hdl-64e"
METHOD = p2o.Method(
    name="mirzaei",
    build=build,
    options=BoardOptions,
    summary="Points of checkerboards on their planes: all minima of the polynomial, no start needed.",
    needs=frozenset({"targets"}),
    cite="Mirzaei, Kottas and Roumeliotis, 3D LIDAR-camera intrinsic and extrinsic calibration: identifiability and "
    "analytical least-squares-based initialization, IJRR 2012",
    example=p2o.Example(f"synthetic:?{_BOARDS}", "10deg 0.3m", "0.9deg 0.06m", joint=True),
)
