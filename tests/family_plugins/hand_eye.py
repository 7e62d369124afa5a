"""A plugin of the tests: hand-eye calibration, from how camera and LiDAR move on one drive. It needs no start.

Between two moments of a rigid rig, camera motion A, LiDAR motion B and extrinsic X obey A X = X B. So X turns the
rotation vectors of B into those of A (Park and Martin, Robot sensor calibration, 1994, in the least-squares form), and
its translation solves (R_A - I) t_X = R_X t_B - t_A.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import p2o
from p2o import Float, Result, Status, se3
from p2o.solving import Judged


class HandEyeOptions(p2o.Options):
    """What a drive has to offer."""

    min_turn_deg: float = p2o.field(
        1.0, gt=0, help="Typical turn between frames about a second axis below which the extrinsic is left open."
    )


@dataclass(frozen=True)
class Moment:
    """Where both sensors are at one frame, each in the world (4, 4) of its own odometry; None where unknown."""

    name: str
    sequence: str
    lidar_world_from_lidar: Float | None
    camera_world_from_camera: Float | None

    @property
    def known(self) -> bool:
        """True where the frame can be paired with others of its drive."""
        both = self.lidar_world_from_lidar is not None and self.camera_world_from_camera is not None
        return both and bool(self.sequence)


@dataclass(frozen=True)
class Motions:
    """Motions (N, 4, 4) of both sensors between pairs of frames, later to earlier; `weight` (N,) is 1 / variance."""

    camera: Float
    lidar: Float
    weight: Float

    @classmethod
    def of(cls, moments: Sequence[Moment]) -> Motions:
        """Return those of all pairs of frames of one drive; errors of odometry add up from frame to frame."""
        drives: dict[str, list[Moment]] = {}
        for moment in moments:
            drives.setdefault(moment.sequence, []).append(moment)
        camera, lidar, weight = [], [], []
        for drive in drives.values():
            for (i, first), (j, second) in combinations(enumerate(drive), 2):
                camera.append(se3.inverse(first.camera_world_from_camera) @ second.camera_world_from_camera)
                lidar.append(se3.inverse(first.lidar_world_from_lidar) @ second.lidar_world_from_lidar)
                weight.append(1.0 / (j - i))
        return cls(np.reshape(camera, (-1, 4, 4)), np.reshape(lidar, (-1, 4, 4)), np.array(weight))

    @property
    def turns_deg(self) -> Float:
        """Typical turns (3,) about the main axes of all rotations of the LiDAR, largest first."""
        spread = np.linalg.svd(np.sqrt(self.weight / self.weight.sum())[:, None] * turns(self.lidar), compute_uv=False)
        return np.degrees(np.pad(spread, (0, 3 - len(spread))))

    def misfit_deg(self, camera_from_lidar: Float) -> float:
        """Return the root mean square angle between A X and X B over all motions."""
        here, there = self.camera @ camera_from_lidar, camera_from_lidar @ self.lidar
        return float(np.degrees(np.sqrt(np.mean(np.sum(turns(se3.inverse(here) @ there) ** 2, axis=1)))))


def turns(transforms: Float) -> Float:
    """Return the rotation vectors (N, 3) in radians of transforms (N, 4, 4)."""
    return np.reshape([se3.rotation_vector(transform[:3, :3]) for transform in transforms], (-1, 3))


def extrinsic(motions: Motions) -> Float:
    """Return camera_from_lidar (4, 4) of motions whose axes span space."""
    moment = turns(motions.camera).T @ (motions.weight[:, None] * turns(motions.lidar))
    u, _, vt = np.linalg.svd(moment)
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    left = motions.camera[:, :3, :3] - np.eye(3)
    right = motions.lidar[:, :3, 3] @ rotation.T - motions.camera[:, :3, 3]
    scale = np.sqrt(motions.weight)[:, None]
    rows = (scale[:, :, None] * left).reshape(-1, 3)
    translation = np.linalg.lstsq(rows, (scale * right).ravel(), rcond=None)[0]
    return se3.make(rotation, translation)


@dataclass(frozen=True)
class HandEye:
    """The whole method."""

    options: HandEyeOptions

    def prepare(self, frame: p2o.Frame) -> Moment:
        """Return where the sensors are; neither picture nor sweep is looked at."""
        return Moment(frame.name, frame.sequence, frame.lidar_world_from_lidar, frame.camera_world_from_camera)

    def solve(self, prepared: Sequence[Moment], camera_from_lidar: Float) -> Result:
        """Return the extrinsic of the motions; the start is only handed back where there is none."""
        names = tuple(moment.name for moment in prepared)
        known = [moment for moment in prepared if moment.known]
        motions = Motions.of(known)

        def refused(status: Status, reason: str) -> Result:
            counts = {"motions": len(motions.weight)}
            return Result(names, camera_from_lidar, camera_from_lidar, status, reason, matches=counts)

        if len(motions.weight) < 3:
            text = f"{len(known)} frames of one drive with poses of both sensors; 3 are needed, calibrated jointly"
            return refused(Status.TOO_FEW_MATCHES, text)
        first, second, _ = motions.turns_deg
        if second < self.options.min_turn_deg:
            text = f"frames differ by turns of {first:.2g} deg about one axis and {second:.2g} deg about a second one"
            return refused(Status.NOT_OBSERVABLE, f"{text}: drive so that it turns about two axes")
        found = extrinsic(motions)
        judged = Judged("hand-eye", "deg", motions.misfit_deg(camera_from_lidar), motions.misfit_deg(found))
        reason = f"{len(motions.weight)} motions agree to {judged.estimate:.2g} deg"
        counts = {"motions": len(motions.weight)}
        return Result(names, camera_from_lidar, found, Status.CONVERGED, reason, matches=counts, judged=judged)


@p2o.hookimpl
def p2o_calibrators():
    """Offer the method."""
    drive = "frames_per_scene=10&place=street&speed_m_s=2.5&period_s=1&swing_deg=40&tilt_deg=6"
    noise = "odometry_noise_deg=0.01&odometry_noise_m=0.001"
    small = "width_px=414&height_px=125&lidar=hdl-32e&right=false"
    yield p2o.Method(
        name="hand-eye-poses",
        build=HandEye,
        options=HandEyeOptions,
        summary="Extrinsic from the motions of both sensors on one drive, without a start.",
        needs={"sequence", "lidar-pose", "camera-pose"},
        cite="Park and Martin, Robot sensor calibration: solving AX = XB on the Euclidean group, 1994",
        example=p2o.Example(f"synthetic:?{drive}&{noise}&{small}", "180deg 1m", "0.1deg 0.03m", joint=True),
    )
