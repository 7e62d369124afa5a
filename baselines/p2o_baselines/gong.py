"""Corners of three planes, `--calibrator gong`, after Gong, Lin and Liu 2013.

    p2o run --data folder:BOXES --joint --calibrator gong

Three planes that meet in a point give their normals and offsets to the LiDAR and the three edges between them to the
camera; they need not be square to each other. Each edge of the sweep has to lie in the plane through the camera and
the edge of the picture. Directions tell the rotation by themselves, then the corner's place the translation, linearly;
one view leaves it open along the corner's ray, two or more do not. From there one least squares on the edges in pixels
moves the pose, and the planes by what their points say of them.

Departures: of the paper its abstract was at hand (a trihedron's geometric constraints, two sub-problems, least
squares), so that these constraints and weights are ours. The paper takes any corner of a room or a house; here corners
are those of boxes in `targets`, found in picture and sweep by the shared room `bodies` (by colour in the picture, by
size in the sweep; the pose uses neither). Corners of rooms are not searched for. The start tells which edge is which:
it may be some 20 deg off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Result, Status, se3
from p2o.arrays import Float

from p2o_baselines.boards.board_method import likely
from p2o_baselines.bodies.body_options import BodyOptions, refused, too_unsure
from p2o_baselines.bodies.box_pairing import BoxSight, box_sight_of, nothing_of
from p2o_baselines.bodies.bundle import adjusted
from p2o_baselines.bodies.trihedron import TrihedronInPicture, TrihedronInSweep, of_picture, of_sweep

_LEAST = 2
_CYCLES = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
_MOST_ANGLE_DEG = 35.0  # between edges as the start has them and as the picture has them
_AWAY_DEG = 25.0  # between the directions of a corner as the start has it and as the picture has it
_MOST_OFF = 6.0  # deviations of an edge beyond which a corner is another


@dataclass(frozen=True)
class Corner:
    """One corner in both sensors, planes numbered as the picture's edges; unknown are moves (9,) of its planes."""

    frame: int
    picture: TrihedronInPicture
    sweep: TrihedronInSweep
    count: int = 9

    @property
    def distance_m(self) -> float:
        """How far the corner is from the LiDAR, which is about that from the camera."""
        return float(np.linalg.norm(self.sweep.corner))

    @property
    def px_per_rad(self) -> float:
        """The scale of the picture at the corner."""
        return self.picture.flat.scale_px

    def residuals(self, camera_from_lidar: Float, own: Float, bias_m: float) -> Float:
        """Return how far two places of each edge are from the sweep's, then how far planes were moved; deviations."""
        moved = self.sweep.moved(own)
        shift = own.copy().reshape(3, 3)
        # Ranges that are too long push a plane away along the rays to it.
        rays = self.sweep.middles / np.linalg.norm(self.sweep.middles, axis=1)[:, None]
        shift[:, 2] += bias_m * np.einsum("ki,ki->k", self.sweep.normals, rays)
        prior = np.einsum("kij,kj->ki", self.sweep.roots, shift).ravel()
        return np.concatenate([edge_offsets(self.picture, moved, camera_from_lidar).ravel(), prior])


def edge_offsets(picture: TrihedronInPicture, sweep: TrihedronInSweep, camera_from_lidar: Float) -> Float:
    """Return by how many deviations (3, 2) two places of each edge of a picture miss the edges of a sweep."""
    at = se3.apply(camera_from_lidar, sweep.corner[None])[0]
    plane = np.cross(at, sweep.ways @ camera_from_lidar[:3, :3].T)
    plane /= np.linalg.norm(plane, axis=1)[:, None]
    ends, sigma_rad = picture.places
    return np.asarray(np.arcsin(np.clip(np.einsum("kei,ki->ke", ends, plane), -1, 1)) / sigma_rad[:, None])


def rotation_of(corners: Sequence[Corner], rotation: Float) -> Float:
    """Return the rotation (3, 3) next to a given one that puts edges into the planes of pictures' edges.

    The first of the two sub-problems: interpretation normal . (R way) = 0, least squares.
    """
    normal = np.concatenate([corner.picture.interpretation for corner in corners])
    way = np.concatenate([corner.sweep.ways for corner in corners])
    for _ in range(50):
        turned = way @ rotation.T
        step = np.linalg.lstsq(np.cross(turned, normal), -np.einsum("ki,ki->k", normal, turned), rcond=None)[0]
        step *= min(1.0, 0.3 / max(float(np.linalg.norm(step)), 1e-12))
        rotation = se3.exp(np.r_[step, 0, 0, 0])[:3, :3] @ rotation
        if np.abs(step).max() < 1e-13:
            break
    return rotation


def translation_of(corners: Sequence[Corner], rotation: Float) -> Float:
    """Return the translation (3,) m that puts corners into the planes of pictures' edges: linear least squares."""
    normal = np.concatenate([corner.picture.interpretation for corner in corners])
    at = np.repeat([rotation @ corner.sweep.corner for corner in corners], 3, axis=0)
    return np.asarray(np.linalg.lstsq(normal, -np.einsum("ki,ki->k", normal, at), rcond=None)[0])


def told_by(
    start: Float, pictures: Sequence[tuple[int, TrihedronInPicture]], sweeps: dict[int, list[TrihedronInSweep]]
) -> list[Corner]:
    """Return the corners that a start (4, 4) has together: of each picture's the sweep's that looks most alike."""
    out = []
    for frame, picture in pictures:
        best: tuple[float, Corner] | None = None
        for sweep in sweeps.get(frame, []):
            at = se3.apply(start, sweep.corner[None])[0]
            ray = picture.flat.rays(picture.corner)
            if at @ ray <= 0 or np.degrees(np.arccos(np.clip(at @ ray / np.linalg.norm(at), -1, 1))) > _AWAY_DEG:
                continue
            for cycle in (*_CYCLES, *(each[::-1] for each in _CYCLES)):
                corner = Corner(frame, picture, _numbered(sweep, cycle))
                angle = _angles_deg(corner, start).max()
                if angle < _MOST_ANGLE_DEG and (best is None or angle < best[0]):
                    best = (float(angle), corner)
        if best is not None:
            out.append(best[1])
    return out


def _numbered(sweep: TrihedronInSweep, order: tuple[int, ...]) -> TrihedronInSweep:
    index = list(order)
    return TrihedronInSweep(
        sweep.normals[index], sweep.offsets[index], sweep.middles[index], sweep.roots[index], sweep.ways[index]
    )


def _angles_deg(corner: Corner, start: Float) -> Float:
    """Return angles (3,) in the picture between edges as a start has them, at the picture's corner, and as they are."""
    flat, picture = corner.picture.flat, corner.picture
    ray = flat.rays(picture.corner)
    tips = flat.seen(ray + 0.01 * corner.sweep.ways @ start[:3, :3].T) - picture.corner
    size = np.linalg.norm(tips, axis=1)
    cosine = np.einsum("ki,ki->k", tips, picture.ways) / np.where(size > 0, size, 1.0)
    return np.degrees(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1, 1)))


@dataclass(frozen=True)
class Gong:
    """The whole method."""

    options: BodyOptions

    def prepare(self, frame: p2o.Frame) -> BoxSight:
        """Return the boxes in picture and sweep, whose corners are used."""
        return box_sight_of(frame, self.options)

    def solve(self, prepared: Sequence[BoxSight], camera_from_lidar: Float) -> Result:
        """Return the pose at which the edges of corners in sweeps are those of pictures."""
        start = np.asarray(camera_from_lidar, np.float64)
        blank = Result(tuple(sight.name for sight in prepared), start, start, Status.NO_FEATURES, "")
        nothing = nothing_of(prepared)
        if nothing:
            return refused(blank, Status.NO_FEATURES, nothing)
        pictures = [
            (number, seen)
            for number, sight in enumerate(prepared)
            for box in sight.pictures
            if (seen := of_picture(box)) is not None
        ]
        sweeps = {number: [of_sweep(box) for box in sight.sweeps] for number, sight in enumerate(prepared)}
        corners = told_by(start, pictures, sweeps)
        if len(corners) < _LEAST:
            return refused(blank, Status.TOO_FEW_MATCHES, _too_few(len(corners), len(pictures), len(prepared)))
        return self._solved(blank, corners, start)

    def _solved(self, blank: Result, corners: list[Corner], start: Float) -> Result:
        options, left_out = self.options, 0
        while True:
            rotation = rotation_of(corners, start[:3, :3])
            pose = se3.make(rotation, translation_of(corners, rotation))
            fit = adjusted(
                corners,
                pose,
                [np.zeros(9)] * len(corners),
                range_bias_m=options.range_bias_m,
                camera_px=options.camera_px,
            )
            off = [
                float(np.abs(corner.residuals(fit.camera_from_lidar, own, 0.0)).max())
                for corner, own in zip(corners, fit.own, strict=True)
            ]
            if max(off) < _MOST_OFF or len(corners) <= _LEAST:
                break
            corners = [corner for k, corner in enumerate(corners) if k != int(np.argmax(off))]
            left_out += 1
        told = replace(
            blank,
            matches={"corners": len(corners), "edges": 3 * len(corners)},
            warnings=(f"{left_out} corners do not agree with the others and are left out",) if left_out else (),
        )
        if max(off) > 2 * _MOST_OFF:
            text = f"edges of {len(corners)} corners do not fit one pose: they are of different things"
            return refused(told, Status.TOO_FEW_MATCHES, text)
        unsure = too_unsure(fit.covariance, fit.camera_from_lidar, "corners", options)
        if fit.covariance is None or unsure:
            return refused(told, Status.NOT_OBSERVABLE, unsure)
        before, after = (_off_px(corners, pose) for pose in (start, fit.camera_from_lidar))
        return Result(
            told.frames,
            start,
            fit.camera_from_lidar,
            Status.CONVERGED,
            f"edges of {len(corners)} corners lie {after:.2f} px off (root mean square)",
            covariance=fit.covariance,
            accuracy=likely(fit.covariance, fit.camera_from_lidar),
            matches=told.matches,
            judged=p2o.Judged("edges off corners", "px", before, after),
            warnings=told.warnings,
        )


def _too_few(count: int, shown: int, frames: int) -> str:
    if shown < _LEAST:
        return (
            f"{shown} pictures of {frames} show a corner with its three edges, {_LEAST} or more are needed: one leaves "
            "the place along its ray open"
        )
    return (
        f"{count} of {shown} corners in pictures are those of sweeps at the start, {_LEAST} or more are needed: one "
        "leaves the place along its ray open, and the start has to be within some 20 deg"
    )


def _off_px(corners: Sequence[Corner], pose: Float) -> float:
    """Return the root mean square of how far edges are off at the middles of their places, in pixels."""
    off = []
    for corner in corners:
        across = np.array([line.across_px for line in corner.picture.lines])
        off.append(edge_offsets(corner.picture, corner.sweep, pose) * np.sqrt(2) * across[:, None])
    return float(np.sqrt(np.mean(np.square(off))))


def build(options: BodyOptions) -> p2o.Calibrator:
    """Return the calibrator."""
    return Gong(options)


_BOXES = "targets=box&place=yard&frames_per_scene=6&width_px=621&height_px=350&right=false&lidar=os1-64"
METHOD = p2o.Method(
    name="gong",
    build=build,
    options=BodyOptions,
    summary="Corners of three planes, here of boxes: edges of sweeps in the planes of pictures' edges; two views.",
    needs=frozenset({"targets"}),
    cite="Gong, Lin and Liu, 3D LIDAR-camera extrinsic calibration using an arbitrary trihedron, Sensors 2013",
    example=p2o.Example(f"synthetic:?{_BOXES}", "10deg 0.3m", "0.8deg 0.06m", joint=True),
)
