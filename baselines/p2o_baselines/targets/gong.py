"""Calibrate with corners of three planes, `--calibrator gong`, after Gong, Lin and Liu 2013.

The LiDAR observes the normals and offsets of three planes that meet in a point, the camera the three edges between
them; they need not be orthogonal. Each edge of the sweep has to lie in the plane through the camera and the edge in the
image. Directions determine the rotation alone; then the position of the corner determines the translation by linear
least squares, with at least two views, because in one view the direction along the ray is unobservable. A final least
squares on edges in pixels adjusts the pose and the planes, with the uncertainty of the planes.

Departures: only the abstract of the paper was at hand (geometric constraints of a trihedron, two sub-problems, least
squares), so these constraints and weights are ours. The paper uses any corner of a room or a building; here corners are
those of boxes in `targets`, detected by the shared package `bodies` (by colour in the image, by size in the sweep; the
pose uses neither). Corners of rooms are not detected. The assignment of edges needs an initial extrinsic within about
20 deg.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Float, Result, Status, se3
from p2o.solving import Judged

from p2o_baselines import examples
from p2o_baselines.bodies.box_pairing import box_sight_of, missing_boxes
from p2o_baselines.bodies.bundle import adjusted
from p2o_baselines.bodies.trihedron import TrihedronInPicture, TrihedronInSweep, of_faces, of_picture
from p2o_baselines.outcome import refused
from p2o_baselines.target_method import Sight, TargetOptions, solved, unsolved

_LEAST = 2
_CYCLES = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
_MOST_ANGLE_DEG = 35.0  # between edges as the start has them and as the image has them
_AWAY_DEG = 25.0  # between the directions of a corner as the start has it and as the image has it
_MOST_OFF = 6.0  # deviations of an edge beyond which a corner is another


@dataclass(frozen=True)
class Corner:
    """One corner in both sensors, planes numbered as the image's edges; unknown are moves (9,) of its planes."""

    frame: int
    image: TrihedronInPicture
    sweep: TrihedronInSweep

    @property
    def camera_scale(self) -> tuple[float, float]:
        """Distance of the corner from the LiDAR in m, which is about that from the camera, and pixels per radian."""
        return float(np.linalg.norm(self.sweep.corner)), self.image.flat.scale_px

    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return how far two places of each edge are from the sweep's, then how far planes were moved; deviations."""
        moved = self.sweep.moved(own)
        shift = own.copy().reshape(3, 3)
        # Ranges that are too long push a plane away along the rays to it.
        rays = self.sweep.middles / np.linalg.norm(self.sweep.middles, axis=1)[:, None]
        shift[:, 2] += bias_m * np.einsum("ki,ki->k", self.sweep.normals, rays)
        prior = np.einsum("kij,kj->ki", self.sweep.roots, shift).ravel()
        return np.concatenate([edge_offsets(self.image, moved, camera_from_lidar).ravel(), prior])


def edge_offsets(image: TrihedronInPicture, sweep: TrihedronInSweep, camera_from_lidar: Float) -> Float:
    """Return by how many deviations (3, 2) two places of each edge of an image miss the edges of a sweep."""
    at = se3.apply(camera_from_lidar, sweep.corner[None])[0]
    plane = np.cross(at, sweep.ways @ camera_from_lidar[:3, :3].T)
    plane /= np.linalg.norm(plane, axis=1)[:, None]
    ends, sigma_rad = image.places
    return np.asarray(np.arcsin(np.clip(np.einsum("kei,ki->ke", ends, plane), -1, 1)) / sigma_rad[:, None])


def rotation_of(corners: Sequence[Corner], rotation: Float) -> Float:
    """Return the rotation (3, 3) near a given one with interpretation normal . (R direction) = 0 by least squares."""
    normal = np.concatenate([corner.image.interpretation for corner in corners])
    direction = np.concatenate([corner.sweep.ways for corner in corners])
    for _ in range(50):
        turned = direction @ rotation.T
        step = np.linalg.lstsq(np.cross(turned, normal), -np.einsum("ki,ki->k", normal, turned), rcond=None)[0]
        step *= min(1.0, 0.3 / max(float(np.linalg.norm(step)), 1e-12))
        rotation = se3.exp(np.r_[step, 0, 0, 0])[:3, :3] @ rotation
        if np.abs(step).max() < 1e-13:
            break
    return rotation


def translation_of(corners: Sequence[Corner], rotation: Float) -> Float:
    """Return the translation (3,) m that puts corners into the planes of images' edges: linear least squares."""
    normal = np.concatenate([corner.image.interpretation for corner in corners])
    at = np.repeat([rotation @ corner.sweep.corner for corner in corners], 3, axis=0)
    return np.asarray(np.linalg.lstsq(normal, -np.einsum("ki,ki->k", normal, at), rcond=None)[0])


def matched(
    start: Float, images: Sequence[tuple[int, TrihedronInPicture]], sweeps: dict[int, list[TrihedronInSweep]]
) -> list[Corner]:
    """Return the corners matched at an initial extrinsic (4, 4): for each in an image the most similar of the sweep."""
    out = []
    for frame, image in images:
        best: tuple[float, Corner] | None = None
        for sweep in sweeps.get(frame, []):
            at, ray = se3.apply(start, sweep.corner[None])[0], image.flat.rays(image.corner)
            if at @ ray <= 0 or np.degrees(np.arccos(np.clip(at @ ray / np.linalg.norm(at), -1, 1))) > _AWAY_DEG:
                continue
            for cycle in (*_CYCLES, *(each[::-1] for each in _CYCLES)):
                corner = Corner(frame, image, _numbered(sweep, cycle))
                angle = _angles_deg(corner, start).max()
                if angle < _MOST_ANGLE_DEG and (best is None or angle < best[0]):
                    best = (float(angle), corner)
        if best is not None:
            out.append(best[1])
    return out


def _numbered(sweep: TrihedronInSweep, order: tuple[int, ...]) -> TrihedronInSweep:
    fields = (sweep.normals, sweep.offsets, sweep.middles, sweep.roots, sweep.ways)
    return TrihedronInSweep(*(each[list(order)] for each in fields))


def _angles_deg(corner: Corner, start: Float) -> Float:
    """Return the angles (3,) in the image between observed edges and those predicted by a pose."""
    flat, image = corner.image.flat, corner.image
    tips = flat.seen(flat.rays(image.corner) + 0.01 * corner.sweep.ways @ start[:3, :3].T) - image.corner
    size = np.linalg.norm(tips, axis=1)
    cosine = np.einsum("ki,ki->k", tips, image.ways) / np.where(size > 0, size, 1.0)
    return np.asarray(np.degrees(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1, 1))))


@dataclass(frozen=True)
class Gong:
    """The calibrator."""

    options: TargetOptions

    def prepare(self, frame: p2o.Frame) -> Sight:
        """Return the boxes in image and sweep, whose corners are used."""
        return box_sight_of(frame, self.options)

    def solve(self, prepared: Sequence[Sight], camera_from_lidar: Float) -> Result:
        """Return the pose at which the edges of corners in sweeps are those of images."""
        start = np.asarray(camera_from_lidar, np.float64)
        result = unsolved(prepared, start)
        missing = missing_boxes(prepared)
        if missing:
            return refused(result, missing)
        boxes = [(number, box) for number, sight in enumerate(prepared) for box in sight.in_image]
        images = [(number, seen) for number, box in boxes if (seen := of_picture(box)) is not None]
        sweeps = {number: [of_faces(box.faces) for box in sight.in_sweep] for number, sight in enumerate(prepared)}
        corners = matched(start, images, sweeps)
        if len(corners) < _LEAST:
            return refused(result, _too_few(len(corners), len(images), len(prepared)), Status.TOO_FEW_MATCHES)
        return self._solved(result, corners, start)

    def _solved(self, result: Result, corners: list[Corner], start: Float) -> Result:
        left_out = 0
        while True:
            rotation = rotation_of(corners, start[:3, :3])
            pose = se3.make(rotation, translation_of(corners, rotation))
            own = [np.zeros(9)] * len(corners)
            fit = adjusted(corners, pose, own)
            off = [
                float(np.abs(corner.residuals(fit.camera_from_lidar, moves, 0.0)).max())
                for corner, moves in zip(corners, fit.own, strict=True)
            ]
            if max(off) < _MOST_OFF or len(corners) <= _LEAST:
                break
            del corners[int(np.argmax(off))]
            left_out += 1
        result = replace(
            result,
            matches={"corners": len(corners), "edges": 3 * len(corners)},
            warnings=(f"{left_out} corners contradict the others and are left out",) if left_out else (),
        )
        if max(off) > 2 * _MOST_OFF:
            reason = f"edges of {len(corners)} corners do not fit one pose: they belong to different objects"
            return refused(result, reason, Status.TOO_FEW_MATCHES)
        before, after = (_off_px(corners, pose) for pose in (start, fit.camera_from_lidar))
        return solved(
            result,
            fit.camera_from_lidar,
            fit.covariance,
            reason=f"edges of {len(corners)} corners are {after:.2f} px off (root mean square)",
            judged=Judged("edges off corners", "px", before, after),
            remedy="add corners elsewhere in the image",
        )


def _too_few(count: int, shown: int, frames: int) -> str:
    few = f"{count} of {shown} corners in images are those of sweeps at the start"
    advice = ", and the start has to be within some 20 deg"
    if shown < _LEAST:
        few, advice = f"{shown} images of {frames} show a corner with its three edges", ""
    return f"{few}, {_LEAST} or more are needed: one leaves the place along its ray open{advice}"


def _off_px(corners: Sequence[Corner], pose: Float) -> float:
    """Return the root mean square distance of edges at the middles of their segments, in pixels."""
    off = []
    for corner in corners:
        across = np.array([line.across_px for line in corner.image.lines])
        off.append(edge_offsets(corner.image, corner.sweep, pose) * np.sqrt(2) * across[:, None])
    return float(np.sqrt(np.mean(np.square(off))))


METHOD = p2o.Method(
    name="gong",
    build=Gong,
    options=TargetOptions,
    summary="Aligns corners of three planes (of boxes): edges of sweeps with edges of images; at least two views.",
    needs=frozenset({"targets"}),
    cite="Gong, Lin and Liu, 3D LIDAR-camera extrinsic calibration using an arbitrary trihedron, Sensors 2013",
    example=examples.targets("box", "os1-64", 6, "0.8deg 0.06m"),
)
