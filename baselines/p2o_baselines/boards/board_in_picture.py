"""Checkerboards in an image: their corners, their poses, and how sure these are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o import Checkerboard, Float, HoleBoard, UInt8, se3

_LEAST_CORNER_PX = 0.05  # lower limit of the standard deviation of a corner
_MOST_RMS_PX = 3.0  # corners that fit no pose of the board so well are another thing, or the camera is another


@dataclass(frozen=True)
class BoardInPicture:
    """A board detected in one image.

    `uv` (N, 2) px are its corners, or edges on the rims of its holes, `camera_from_board` (4, 4) the fitted pose,
    `covariance` (6, 6) that of a left update of the pose (rad, m), `rms_px` the residual of the fit, `px_per_rad` the
    scale of the image there.
    """

    target: Checkerboard | HoleBoard
    uv: Float
    camera_from_board: Float
    covariance: Float
    rms_px: float
    px_per_rad: float

    @property
    def normal(self) -> Float:
        """The board's normal (3,) in the camera frame, towards the camera."""
        normal = self.camera_from_board[:3, 2]
        return -normal if normal @ self.camera_from_board[:3, 3] > 0 else normal

    @property
    def offset_m(self) -> float:
        """Return the offset of the plane normal . x = offset; negative, since the normal points to the camera."""
        return float(self.normal @ self.camera_from_board[:3, 3])


def boards_in_picture(image: p2o.Image, targets: Sequence[p2o.Target]) -> tuple[BoardInPicture, ...]:
    """Detect checkerboards, each at most once, if the lens distorts through a virtual pinhole camera too."""
    import cv2

    boards, grey = [], image.grey.copy()
    for target in [each for each in targets if isinstance(each, Checkerboard)]:
        for uv in _corners(grey, image.camera, target):
            board = _posed(image.camera, target, uv)
            if board is None:
                continue
            # Mask the detected board, so that the next detection finds a second board of the same pattern.
            cv2.fillConvexPoly(grey, cv2.convexHull(np.rint(uv).astype(np.int32)), 128)
            boards.append(board)
            break
    return tuple(boards)


def _corners(grey: UInt8, camera: p2o.Camera, target: Checkerboard) -> Iterator[Float]:
    """Give corners (N, 2) px of the image, first as the image shows them, then as a pinhole camera would."""
    direct = _detected(grey, target)
    if direct is not None:
        yield direct
    if camera.is_pinhole:
        return
    pinhole = p2o.Camera.pinhole(
        camera.focal_px, camera.focal_px, (camera.width - 1) / 2, (camera.height - 1) / 2, camera.width, camera.height
    )
    seen = _detected(_through(grey, camera, pinhole), target)
    if seen is not None and np.isfinite(uv := camera.project(pinhole.rays(seen))).all():
        yield uv


def _through(grey: UInt8, camera: p2o.Camera, pinhole: p2o.Camera) -> UInt8:
    """Return the image as another camera at the same place would show it."""
    import cv2

    u, v = np.meshgrid(np.arange(pinhole.width, dtype=np.float64), np.arange(pinhole.height, dtype=np.float64))
    uv = np.nan_to_num(camera.project(pinhole.rays(np.stack([u, v], axis=-1))), nan=-1.0).astype(np.float32)
    return np.asarray(cv2.remap(grey, uv[..., 0], uv[..., 1], cv2.INTER_LINEAR), np.uint8)


def _detected(grey: UInt8, target: Checkerboard) -> Float | None:
    import cv2

    flags = cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE
    seen, corners = cv2.findChessboardCornersSB(grey, (target.columns, target.rows), flags=flags)
    return np.asarray(corners, np.float64).reshape(-1, 2) if seen else None


def _posed(camera: p2o.Camera, target: Checkerboard, uv: Float) -> BoardInPicture | None:
    """Return the board at the pose that fits its corners best; None if none fits."""
    import cv2

    rays = camera.rays(uv)
    if not np.isfinite(rays).all():
        return None
    plane = rays[:, :2] / rays[:, 2:]
    # A planar board has two poses with similar residuals: refine both and keep the better one.
    _, turns, shifts, _ = cv2.solvePnPGeneric(target.corners, plane, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    poses = (se3.make(cv2.Rodrigues(turn)[0], shift.ravel()) for turn, shift in zip(turns, shifts, strict=True))
    fits = [refined(camera, target, uv, pose) for pose in poses]
    best = min((fit for fit in fits if fit is not None), key=lambda board: board.rms_px, default=None)
    return best if best is not None and best.rms_px < _MOST_RMS_PX else None


def refined(camera: p2o.Camera, target: Checkerboard, uv: Float, camera_from_board: Float) -> BoardInPicture | None:
    """Return the board at the pose next to a given one (4, 4) that puts its corners nearest to `uv` (N, 2) px."""
    pose = camera_from_board
    for _ in range(20):
        xyz = se3.apply(pose, target.corners)
        seen, by_point = camera.project_with_jacobian(xyz)
        if not np.isfinite(seen).all():
            return None
        by_update = np.concatenate([by_point @ -se3.skew(xyz), by_point], axis=2).reshape(-1, 6)
        off = (seen - uv).ravel()
        step = np.linalg.lstsq(by_update, -off, rcond=None)[0]
        pose = se3.exp(step) @ pose
        if np.abs(step).max() < 1e-10:
            break
    rms = float(np.sqrt((off**2).sum() / max(len(off) - 6, 1)))
    sigma = max(rms, _LEAST_CORNER_PX)
    covariance = sigma**2 * np.linalg.pinv(by_update.T @ by_update)
    scale = float(np.median(np.linalg.norm(by_point, axis=(1, 2)) * np.linalg.norm(xyz, axis=1)) / np.sqrt(2))
    return BoardInPicture(target, np.asarray(uv, np.float64), pose, covariance, rms, scale)
