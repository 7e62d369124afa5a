"""Sources of frames and changes of them for `adversarial.py`: inputs whose result is wrong, or may be."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from p2o import Camera, Cloud, Frame
from p2o.arrays import Float, UInt8
from p2o.frames.image import Image
from p2o.geometry.radial_error import RadialError

NO_POSE = frozenset({"other moment", "mirrored image", "other camera", "axes swapped", "units", "units, feet"})
"""Kinds without a right pose: every trusted result is a false accept. For the others it is one that is wrong."""

NOT_OBSERVABLE = frozenset({"units, feet", "principal point 20 px"})
"""Kinds that leave the projection of the sweep as it is, or nearly so, at a wrong pose."""


@dataclass(frozen=True)
class Source:
    """Frames of one rig, by data set and selection; `most` are taken, spread evenly.

    `kind` is that of its unchanged frames. `moves` states that the frames show different scenes, so that the sweep of
    another frame is a wrong pair; `after` that the frame after each one taken follows it within a second; `together`
    that they may be solved jointly.
    """

    name: str
    data: str
    frames: str = "all"
    kind: str = "unchanged"
    most: int = 8
    moves: bool = True
    after: bool = False
    together: bool = True


def _drive(name: str, words: str, **rest: object) -> Source:
    seed = sum(map(ord, name))
    data = f"synthetic:?right=false&scenes=8&frames_per_scene=2&period_s=0.2&seed={seed}&{words}"
    return Source(f"sim-{name}", data, after=True, **rest)  # type: ignore[arg-type]


def _hard(name: str, kind: str, words: str, most: int = 24) -> Source:
    seed = sum(map(ord, name))
    return Source(f"sim-{name}", f"synthetic:?right=false&scenes={most}&seed={seed}&{words}", kind=kind, most=most)


def _rig(name: str, frames: str, **rest: object) -> Source:
    return Source(name, f"folder:build/data/rigs/{name}", frames, **rest)  # type: ignore[arg-type]


RAW = "kitti-raw:build/data/kitti_raw"
SOURCES: Sequence[Source] = (
    Source("kitti-raw", RAW, "@{splits}#train", most=8),
    Source("drive-0005", RAW, "@{splits}#drive_0005_later", most=8, after=True),
    Source("odometry-00", "kitti-odometry:build/data/kitti_odometry", "@{splits}#odometry00-dev", most=8),
    _rig("waymo", "@{splits}#waymo-dev"),
    _rig("nuscenes", "@{splits}#nuscenes-dev", moves=False, together=False),
    _rig("pjlab", "@{splits}#pjlab-dev", together=False),
    _rig("hitsz", "@{splits}#hitsz-dev", moves=False),
    _drive("street-hdl64", "place=street&lidar=hdl-64e"),
    _drive("suburb-hdl64", "place=suburb&lidar=hdl-64e&width_px=800&height_px=400"),
    _drive("hall-os1", "place=hall&lidar=os1-64&width_px=1000&height_px=560"),
    _drive("street-os1", "place=street&lidar=os1-64&width_px=1000&height_px=560"),
    _drive("street-vlp16", "place=street&lidar=vlp-16&width_px=1000&height_px=560"),
    _hard("repeated-hdl64", "repeated structures", "place=repeated&lidar=hdl-64e"),
    _hard("repeated-os1", "repeated structures", "place=repeated&lidar=os1-64&width_px=1000&height_px=560"),
    _hard("empty", "empty road", "place=empty&lidar=hdl-64e"),
    _hard("empty-os1", "empty road", "place=empty&lidar=os1-64&width_px=1000&height_px=560"),
    _hard("traffic", "moving objects alone", "place=traffic&lidar=hdl-64e"),
    _hard("fog", "fog", "place=street&weather=fog&lidar=hdl-64e"),
    _hard("rain", "rain", "place=street&weather=rain&lidar=os1-64&width_px=1000&height_px=560"),
    _hard("night", "night", "place=street&weather=night&lidar=hdl-64e"),
)

Change = Callable[[Sequence[Frame], int], Frame]
"""Gives frame n of a list with a change."""


def with_camera(frame: Frame, camera: Camera) -> Frame:
    """Return the frame with another camera of the same size."""
    return replace(frame, image=replace(frame.image, camera=camera))


def with_rgb(frame: Frame, rgb: UInt8) -> Frame:
    """Return the frame with another image of the same size, without right image, depth and mask."""
    return replace(frame, image=Image(np.ascontiguousarray(rgb), frame.image.camera))


def with_points(frame: Frame, matrix: Float) -> Frame:
    """Return the frame with the points of its sweep multiplied by a matrix (3, 3) or a number."""
    return replace(frame, cloud=replace(frame.cloud, xyz=frame.cloud.xyz @ (np.eye(3) * matrix), twist=None))


def _intrinsics(**error: float) -> Change:
    return lambda frames, n: with_camera(frames[n], RadialError(**error).corrected(frames[n].camera))


def _scaled(factor: float) -> Change:
    return lambda frames, n: with_points(frames[n], np.asarray(factor))


def _axes(rows: Sequence[Sequence[int]]) -> Change:
    return lambda frames, n: with_points(frames[n], np.array(rows, np.float64).T)


def _sweep_of(frames: Sequence[Frame], n: int) -> Frame:
    other: Cloud = frames[(n + len(frames) // 2) % len(frames)].cloud
    return replace(frames[n], cloud=other, sweep=None)


def _image_of(frames: Sequence[Frame], n: int) -> Frame:
    """Return the frame with the image of the next camera, to be calibrated from the pose of its own."""
    return replace(frames[n], image=frames[(n + 1) % len(frames)].image)


def _focal(factor: float) -> Change:
    """Change the focal length by more than a calibration error: that of another lens."""

    def change(frames: Sequence[Frame], n: int) -> Frame:
        camera = frames[n].camera
        params = list(camera.params)
        for at in range(1 if camera.model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL") else 2):
            params[at] *= factor
        return with_camera(frames[n], replace(camera, params=tuple(params)))

    return change


def sheared(rgb: UInt8, shift_px: float) -> UInt8:
    """Return the image (H, W, 3) as a rolling shutter shows it while the camera turns.

    Rows move sideways by 0 px in the middle to `shift_px` at the bottom, and the opposite at the top.
    """
    height, width = rgb.shape[:2]
    slope = 2 * shift_px / height
    move = np.array([[1.0, slope, -slope * (height - 1) / 2], [0.0, 1.0, 0.0]])
    turned: UInt8 = cv2.warpAffine(rgb, move, (width, height), borderMode=cv2.BORDER_REPLICATE).astype(np.uint8)
    return turned


def _shutter(angle: float) -> Change:
    """Shear the image by the angle (rad) by which the camera turns in half the time of the readout."""
    return lambda frames, n: with_rgb(frames[n], sheared(frames[n].image.rgb, angle * frames[n].camera.focal_px))


def _mirrored(frames: Sequence[Frame], n: int) -> Frame:
    return with_rgb(frames[n], frames[n].image.rgb[:, ::-1])


CHANGES: Mapping[str, Mapping[str, Change]] = {
    "mirrored image": {"": _mirrored},
    "axes swapped": {
        "y mirrored": _axes([[1, 0, 0], [0, -1, 0], [0, 0, 1]]),
        "x and y": _axes([[0, 1, 0], [1, 0, 0], [0, 0, 1]]),
        "z down": _axes([[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
        "turned by 90 deg": _axes([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    },
    "units": {"millimetres": _scaled(1000.0), "centimetres": _scaled(100.0), "kilometres": _scaled(0.001)},
    "units, feet": {"": _scaled(0.3048)},
    "scaled cloud": {"+10 %": _scaled(1.1), "-10 %": _scaled(0.9)},
    "focal length 3 %": {"+": _intrinsics(focal=0.03), "-": _intrinsics(focal=-0.03)},
    "focal length 5 %": {"+": _intrinsics(focal=0.05), "-": _intrinsics(focal=-0.05)},
    "focal length 20 %": {"+": _focal(1.2), "-": _focal(0.8)},
    "principal point 20 px": {
        "x+": _intrinsics(x_px=20.0), "x-": _intrinsics(x_px=-20.0),
        "y+": _intrinsics(y_px=20.0), "y-": _intrinsics(y_px=-20.0),
    },
    "forgotten distortion": {"+": _intrinsics(radial=0.1), "-": _intrinsics(radial=-0.1)},
    "rolling shutter": {"0.5 deg": _shutter(np.radians(0.5)), "2 deg": _shutter(np.radians(2.0))},
}  # fmt: skip
"""Changes by kind and variant that every source allows; `changes_of` gives all of a source."""


def changes_of(source: Source, following: Mapping[str, Frame]) -> dict[str, dict[str, Change]]:
    """Return the changes for a source by kind and variant; `following` are the frames after those taken, by name."""
    same: dict[str, Change] = {"": lambda frames, n: frames[n]}
    if source.kind != "unchanged":
        return {source.kind: same}
    changes = {source.kind: same, **{kind: dict(variants) for kind, variants in CHANGES.items()}}
    if source.moves:
        changes["other moment"] = {"": _sweep_of}
    if source.name == "nuscenes":
        changes["other camera"] = {"": _image_of}
    if following:
        changes["unsynchronised"] = {
            "next image": lambda frames, n: replace(frames[n], image=following[frames[n].name].image)
        }
    changes["duplicated frames"] = same
    return changes
