"""A plugin of the tests: checkerboards. The sweep's points on a board must lie in its plane and within its border.

Extrinsic and boards are adjusted together, since the LiDAR knows the tilt of a far board better than the camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Bool, Checkerboard, Float, Result, Status, se3


class BoardOptions(p2o.Options):
    """What counts as a point of a board, and how exact both sensors are."""

    reach_m: float = p2o.field(0.6, gt=0, help="How far from its predicted place a board is looked for at first.")
    rounds: int = p2o.field(2, ge=1, help="How often points are chosen anew at the better pose.")
    point_sigma_m: float = p2o.field(0.02, gt=0, help="Deviation of a point from its board.")
    corner_sigma_px: float = p2o.field(0.1, gt=0, help="Deviation of a corner in the picture.")


@dataclass(frozen=True)
class Board:
    """A board in one picture: its corners there (N, 2) and its pose camera_from_board (4, 4) by them alone."""

    camera: p2o.Camera
    target: Checkerboard
    uv: Float
    camera_from_board: Float

    def misfits(self, xyz: Float, camera_from_lidar: Float, camera_from_board: Float, options: BoardOptions) -> Float:
        """Return residuals (2 N + 3 K,) in deviations: corners, then points (K, 3) off the plane and off the border."""
        across, down, off = se3.apply(se3.inverse(camera_from_board) @ camera_from_lidar, xyz).T
        sides = ((across, self.target.width_m / 2), (down, self.target.height_m / 2))
        beyond = [np.sign(at) * np.maximum(np.abs(at) - half, 0.0) for at, half in sides]
        corners = self.camera.project(se3.apply(camera_from_board, self.target.corners)) - self.uv
        return np.concatenate([corners.ravel() / options.corner_sigma_px, np.r_[off, *beyond] / options.point_sigma_m])


@dataclass(frozen=True)
class Sight:
    """What a frame has to do with boards: those in its picture, and the near points (N, 3) of its sweep."""

    name: str
    boards: list[Board]
    xyz: Float


def boards_in(image: p2o.Image, targets: Sequence[p2o.Target]) -> list[Board]:
    """Return the boards that are found in a picture."""
    import cv2

    grey, found = image.grey.copy(), []
    for target in [each for each in targets if isinstance(each, Checkerboard)]:
        flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
        seen, corners = cv2.findChessboardCornersSB(grey, (target.columns, target.rows), flags=flags)
        if not seen:
            continue
        # Covered up, so that a second board of the same pattern is found next.
        cv2.fillConvexPoly(grey, cv2.convexHull(np.rint(corners).astype(np.int32)), 128)
        uv = np.asarray(corners.reshape(-1, 2), np.float64)
        x, y, z = image.camera.rays(uv).T
        solved, turn, shift = cv2.solvePnP(target.corners, np.c_[x / z, y / z], np.eye(3), None)
        if solved:
            found.append(Board(image.camera, target, uv, se3.make(cv2.Rodrigues(turn)[0], shift.ravel())))
    return found


def on_plane(xyz: Float, within_m: float) -> Bool:
    """Return which points (N, 3) in a board's frame lie in the plane most do that is turned by less than 30 deg."""
    corners = xyz[np.random.default_rng(0).integers(len(xyz), size=(200, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(normals, axis=1)
    facing = np.abs(normals[:, 2]) > 0.87 * size
    normals, origins = normals[facing] / size[facing, None], corners[facing, 0]
    near = np.abs(xyz @ normals.T - np.sum(normals * origins, axis=1)) < within_m
    return near[:, np.argmax(near.sum(axis=0))] if facing.any() else np.zeros(len(xyz), bool)


@dataclass(frozen=True)
class BoardMethod:
    """The whole method."""

    options: BoardOptions

    def prepare(self, frame: p2o.Frame) -> Sight:
        """Return the boards in the picture and the near points of the sweep."""
        near = frame.cloud.xyz[np.linalg.norm(frame.cloud.xyz, axis=1) < 12.0]
        return Sight(frame.name, boards_in(frame.image, frame.targets), near)

    def touched(self, sights: Sequence[Sight], camera_from_lidar: Float, reach_m: float) -> list[tuple[Board, Float]]:
        """Return boards with the points on them, looked for near to where each should be."""
        found = []
        for sight, board in ((each, board) for each in sights for board in each.boards):
            inside = se3.apply(se3.inverse(board.camera_from_board) @ camera_from_lidar, sight.xyz)
            half = np.array([board.target.width_m / 2, board.target.height_m / 2, 0.0])
            near = (np.abs(inside) < half + reach_m).all(axis=1)
            near[near] = on_plane(inside[near], 1.5 * self.options.point_sigma_m) if near.sum() >= 30 else False
            found += [(board, sight.xyz[near])] * bool(near.sum() >= 30)
        return found

    def adjusted(self, touched: Sequence[tuple[Board, Float]], camera_from_lidar: Float) -> Float:
        """Return the extrinsic that fits best together with the poses of all boards."""
        from scipy.optimize import least_squares
        from scipy.sparse import block_diag, hstack

        def misfits(steps: Float) -> Float:
            own, *turns = se3.exp(steps.reshape(-1, 6))
            poses = [board.camera_from_board @ turn for (board, _), turn in zip(touched, turns, strict=True)]
            pairs, pose = zip(touched, poses, strict=True), own @ camera_from_lidar
            return np.concatenate([board.misfits(xyz, pose, at, self.options) for (board, xyz), at in pairs])

        # The extrinsic acts on all residuals, the pose of a board on those of its own.
        blocks = [np.ones((2 * len(board.uv) + 3 * len(xyz), 6)) for board, xyz in touched]
        acts, zero = hstack([np.concatenate(blocks), block_diag(blocks)]), np.zeros(6 * (1 + len(touched)))
        found = least_squares(misfits, zero, jac_sparsity=acts, loss="soft_l1", x_scale="jac", ftol=1e-5)
        return np.asarray(se3.exp(found.x[:6]) @ camera_from_lidar)

    def solve(self, prepared: Sequence[Sight], camera_from_lidar: Float) -> Result:
        """Return the pose at which all boards hold their points."""
        names, pose, start = tuple(sight.name for sight in prepared), camera_from_lidar, camera_from_lidar
        for number in range(self.options.rounds):
            touched = self.touched(prepared, pose, max(self.options.reach_m / 3**number, 0.1))
            matches = {"points": sum(len(xyz) for _, xyz in touched)}
            normals = np.reshape([board.camera_from_board[:3, 2] for board, _ in touched], (-1, 3))
            if len(touched) < 3 or np.linalg.svd(normals, compute_uv=False)[2] < 0.1:
                status = Status.TOO_FEW_MATCHES if len(touched) < 3 else Status.NOT_OBSERVABLE
                reason = f"{len(touched)} boards seen by both sensors; 3 or more that face different ways are needed"
                return Result(names, start, start, status, reason, matches=matches)
            pose = self.adjusted(touched, pose)
        return Result(names, start, pose, Status.CONVERGED, f"points lie on {len(touched)} boards", matches=matches)


@p2o.hookimpl
def p2o_calibrators():
    """Offer the method."""
    boards = "targets=checkerboard&place=yard&frames_per_scene=10&width_px=621&height_px=188&right=false&lidar=hdl-32e"
    yield p2o.Method(
        name="checkerboard",
        build=BoardMethod,
        options=BoardOptions,
        summary="Extrinsic from checkerboards that both sensors see.",
        needs={"targets"},
        cite="Zhang and Pless, Extrinsic calibration of a camera and laser range finder, 2004",
        example=p2o.Example(f"synthetic:?{boards}", "2deg 0.1m", "0.3deg 0.03m", joint=True),
    )
