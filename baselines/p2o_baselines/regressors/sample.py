"""Label files as samples (undistorted image, sweep at the true extrinsic), and training inputs drawn from them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import p2o
from p2o import Float, InputError, UInt8, se3
from p2o.reading import read_bytes, read_npz

from p2o_baselines.regressors.network_input import Channel, Size, drawn, reflectance_of, thinned
from p2o_baselines.regressors.options import Augmentation

Reach = tuple[float, float]
"""Bounds of an initial error: degrees about each axis, metres along each."""
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


@dataclass(frozen=True, eq=False)
class AugmentedSample:
    """`rgb` (h, w, 3) uint8 and `sweep` (C, h, w) at the initial extrinsic, its correction, and the inputs of losses.

    `xyz` (P, 3) are points in the camera frame at the initial extrinsic (metres), `intrinsics` (4,) fx fy cx cy of the
    grid, `reach` (2,) the bounds of the error in rad and m, `true_nearness` (h, w) the sweep at the true extrinsic,
    `hand_eye` (2, 4, 4) the motions of camera and LiDAR since the previous sample of the window, NaN if unknown.
    """

    rgb: UInt8
    sweep: Float
    correction: Float
    reach: Float
    xyz: Float
    intrinsics: Float
    true_nearness: Float
    hand_eye: Float
    start: Float


@dataclass(frozen=True, eq=False)
class View:
    """Pinhole view of a sample, common to the frames of a window: zoom, position, mirror, rotation, and error."""

    zoom: float
    place: Float
    mirrored: bool
    turn: Float
    wrong: Float
    reach: Reach
    other_lidar: Float


def error(reach: Reach, rng: np.random.Generator) -> Float:
    """Return an error T_e (4, 4) with T_start = T_e T_true: uniform Euler angles and a shift within a reach."""
    from scipy.spatial.transform import Rotation

    turn, shift = rng.uniform(-1, 1, size=(2, 3))
    return se3.make(Rotation.from_euler("xyz", turn * reach[0], degrees=True).as_matrix(), shift * reach[1])


def draw_view(reaches: Sequence[Reach], augmentation: Augmentation, rng: np.random.Generator) -> View:
    """Draw a random view, with the error of its initial extrinsic."""
    from scipy.spatial.transform import Rotation

    reach = reaches[int(rng.integers(len(reaches)))]
    turn = Rotation.from_euler("xyz", rng.uniform(-1, 1, 3) * augmentation.turn_deg, degrees=True).as_matrix()
    other = np.eye(4)
    if augmentation.reexpress:
        other = se3.make(Rotation.random(random_state=int(rng.integers(1 << 31))).as_matrix(), rng.normal(size=3))
    zoom = float(np.exp(rng.uniform(0, np.log(augmentation.zoom))))
    place, mirrored = rng.uniform(0, 1, 2), bool(augmentation.mirror and rng.random() < 0.5)
    return View(zoom, place, mirrored, np.asarray(turn), error(reach, rng), reach, other)


def shrunk(sample: Sample, size: Size, zoom: float) -> Sample:
    """Return a sample whose image is downsampled to the resolution that the largest zoom needs."""
    import cv2

    height, width = sample.rgb.shape[:2]
    scale = min(1.0, 1.2 * zoom * max(size[0] / height, size[1] / width))
    if scale > 0.9:
        return sample
    small = (max(1, round(width * scale)), max(1, round(height * scale)))
    by = np.array(small) / [width, height]
    rgb = np.asarray(cv2.resize(sample.rgb, small, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return replace(sample, rgb=rgb, focal=sample.focal * by, centre=(sample.centre + 0.5) * by - 0.5)


def grid_camera(sample: Sample, size: Size, zoom: float, place: Float) -> Float:
    """Return fx fy cx cy (4,) of a network's grid that shows a crop of a sample at a position (2,) in 0..1."""
    height, width = sample.rgb.shape[:2]
    scale = min(width / size[1], height / size[0]) / zoom
    corner = place * (np.array([width, height]) - scale * np.array(size[::-1]))
    return np.concatenate([sample.focal / scale, (sample.centre + 0.5 - corner) / scale - 0.5])


def augment(
    sample: Sample,
    seen: View,
    size: Size,
    channels: Sequence[Channel],
    points: int,
    augmentation: Augmentation,
    rng: np.random.Generator,
    before: Sample | None = None,
    *,
    with_truth: bool = True,
) -> AugmentedSample:
    """Return a sample in a view, after `before` in its window; `with_truth` draws the map at the true extrinsic too."""
    import cv2

    grid = grid_camera(sample, size, seen.zoom, seen.place)
    matrix = np.array([[grid[0], 0, grid[2]], [0, grid[1], grid[3]], [0, 0, 1]])
    old = np.array([[sample.focal[0], 0, sample.centre[0]], [0, sample.focal[1], sample.centre[1]], [0, 0, 1]])
    warp = matrix @ seen.turn @ np.linalg.inv(old)
    rgb = cv2.warpPerspective(sample.rgb, warp, size[::-1], flags=cv2.INTER_LINEAR)
    camera_from_camera = se3.make(seen.turn, np.zeros(3))
    if seen.mirrored:
        rgb = np.asarray(rgb)[:, ::-1]
        grid[2] = size[1] - 1 - grid[2]
        camera_from_camera = _MIRROR @ camera_from_camera
    keep = some(len(sample.xyz), augmentation, rng)
    in_view = sample.xyz[keep] @ camera_from_camera[:3, :3].T.astype(np.float32)
    wrong = seen.wrong.astype(np.float32)
    at_start = in_view @ wrong[:3, :3].T + wrong[:3, 3]
    xyz_lidar = None
    if "x" in channels:
        # Mirror in the LiDAR frame too: a left-handed frame would reveal to the network that the image is mirrored.
        lidar_from_camera = se3.inverse(sample.camera_from_lidar)
        mirror = np.diag([1.0, -1.0, 1.0, 1.0]) if seen.mirrored else np.eye(4)
        xyz_lidar = se3.apply(seen.other_lidar @ mirror @ lidar_from_camera, sample.xyz[keep])
    sweep = drawn(projected(at_start, grid), at_start[:, 2], size, channels, sample.reflectance[keep], xyz_lidar)
    true = drawn(projected(in_view, grid), in_view[:, 2], size)[0] if with_truth else np.zeros(size, np.float32)
    chosen = rng.integers(len(in_view), size=points)
    return AugmentedSample(
        lit(rgb, augmentation.light, rng),
        sweep,
        se3.inverse(seen.wrong),
        np.array([np.radians(seen.reach[0]), seen.reach[1]]),
        at_start[chosen],
        grid,
        np.asarray(true, np.float64),
        hand_eye(before, sample, camera_from_camera, seen),
        seen.wrong @ camera_from_camera @ sample.camera_from_lidar,
    )


def some(count: int, augmentation: Augmentation, rng: np.random.Generator) -> slice:
    """Return which of the points of a sample are used: neighbours of a list whose order is one random."""
    most = min(count, augmentation.most_points)
    used = max(1, int(most * rng.uniform(augmentation.thin, 1.0)))
    first = int(rng.integers(count - used + 1))
    return slice(first, first + used)


def projected(xyz: Float, grid: Float) -> Float:
    """Return pixels (N, 2) of points (N, 3) in a pinhole fx fy cx cy (4,); NaN behind it."""
    scale = 1.0 / np.where(xyz[:, 2] > 1e-6, xyz[:, 2], np.nan)
    out = np.empty((len(xyz), 2), xyz.dtype)
    for axis in (0, 1):
        out[:, axis] = xyz[:, axis] * scale * grid[axis] + grid[2 + axis]
    return out


def hand_eye(before: Sample | None, sample: Sample, camera_from_camera: Float, seen: View) -> Float:
    """Return the motions (2, 4, 4) of the view's camera and LiDAR, later from earlier; NaN if unknown or mirrored."""
    unknown = np.full((2, 4, 4), np.nan)
    if before is None or seen.mirrored:
        return unknown
    worlds = ("camera_world_from_camera", "lidar_world_from_lidar")
    poses = [[getattr(each, world) for each in (before, sample)] for world in worlds]
    if not np.isfinite(poses).all():
        return unknown
    camera, lidar = (se3.inverse(later) @ earlier for earlier, later in poses)
    return np.stack([camera_from_camera @ camera @ se3.inverse(camera_from_camera), lidar])


def lit(rgb: UInt8, strength: float, rng: np.random.Generator) -> UInt8:
    """Return an image (h, w, 3) with changed exposure, contrast, colour and noise; strength 0 leaves it unchanged."""
    if strength <= 0:
        return np.ascontiguousarray(rgb)
    gain = np.exp(strength * (rng.normal(0, 0.2) + rng.normal(0, 0.05, 3)))
    gamma, more = np.exp(strength * rng.normal(0, 0.15)), strength * rng.normal(0, 10)
    table = 255.0 * np.power(np.arange(256) / 255.0, gamma)[:, None] * gain + more
    noise = rng.standard_normal(rgb.shape[:2], np.float32)[..., None] * (strength * rng.uniform(0, 6))
    return np.clip(table[rgb, np.arange(3)] + noise, 0, 255).astype(np.uint8)


_WIDEST_PX = 1280
_MOST_POINTS = 60_000
_LEAST_POINTS = 200
_BESIDE_DEG = 35.0  # margin around the image of kept points: a wrong initial extrinsic may project them into the image
_MOST_BYTES = 64 << 20


@dataclass(frozen=True, eq=False)
class Sample:
    """`rgb` (H, W, 3) of a pinhole camera `focal` (2,) and `centre` (2,) in pixels; `xyz` (N, 3) in its frame.

    Points are in random order, their `reflectance` (N,) is in 0..1; `camera_from_lidar` (4, 4) is the true extrinsic.
    `group` is the drive; the poses of both sensors at the time of the image, each in its own world, are NaN if unknown.
    """

    name: str
    group: str
    rgb: UInt8
    focal: Float
    centre: Float
    xyz: Float
    reflectance: Float
    camera_from_lidar: Float
    camera_world_from_camera: Float
    lidar_world_from_lidar: Float

    def packed(self) -> bytes:
        """Return the content of the label file."""
        file = io.BytesIO()
        np.savez_compressed(file, **{**vars(self), "xyz": self.xyz.astype(np.float32)})
        return file.getvalue()

    @classmethod
    def load(cls, path: Path) -> Sample:
        """Read what `packed` wrote; raises InputError for other content."""
        shapes: dict[str, tuple[int, ...]] = {"focal": (2,), "centre": (2,)}
        poses = ("camera_from_lidar", "camera_world_from_camera", "lidar_world_from_lidar")
        shapes |= dict.fromkeys(poses, (4, 4))
        try:
            file = read_npz(read_bytes(path, "file of labels", _MOST_BYTES), path)
            rgb, xyz, reflectance = file["rgb"], file["xyz"], file["reflectance"]
            if rgb.dtype != np.uint8 or rgb.ndim != 3 or rgb.shape[2] != 3 or xyz.shape != (len(reflectance), 3):
                raise ValueError(f"rgb {rgb.dtype} {rgb.shape}, xyz {xyz.shape}")
            rest = {name: np.asarray(file[name], np.float64).reshape(shape) for name, shape in shapes.items()}
            return cls(str(file["name"]), str(file["group"]), rgb, xyz=xyz, reflectance=reflectance, **rest)
        except (ValueError, KeyError, InputError) as problem:
            got = problem.what if isinstance(problem, InputError) else problem
            expected = "a file written by p2o labels"
            raise InputError("a label file cannot be read", where=path, expected=expected, got=got) from problem


def sample_of(frame: p2o.Frame) -> Sample:
    """Return the sample of a frame; raises InputError if its extrinsic is unknown or its camera sees too few points."""
    unusable = "the frame cannot be used for training"
    if frame.camera_from_lidar is None:
        raise InputError(unusable, where=frame.name, expected="a true extrinsic", got="none")
    rgb, camera = flat(frame.image)
    cloud = thinned(frame.cloud, 4 * _MOST_POINTS)
    in_camera = se3.apply(frame.camera_from_lidar, cloud.xyz)
    fx, fy, cx, cy = camera.params
    beside = np.tan(np.radians(np.minimum(_BESIDE_DEG + np.degrees(np.arctan([cx / fx, cy / fy])), 85.0)))
    near_view = (in_camera[:, 2] > 0.3) & (np.abs(in_camera[:, :2]) < beside * in_camera[:, 2:]).all(axis=1)
    near = np.random.default_rng(0).permutation(np.flatnonzero(near_view))[:_MOST_POINTS]
    if camera.in_image(camera.project(in_camera[near])).sum() < _LEAST_POINTS:
        expected = f"{_LEAST_POINTS} points or more in the image"
        raise InputError(unusable, where=frame.name, expected=expected, got="fewer")
    unknown = np.full((4, 4), np.nan)
    world = (frame.camera_world_from_camera, frame.lidar_world_from_lidar)
    return Sample(
        frame.name,
        frame.sequence or frame.name.rpartition("/")[0],
        rgb,
        np.array([fx, fy]),
        np.array([cx, cy]),
        in_camera[near],
        reflectance_of(cloud)[near].astype(np.float32),
        frame.camera_from_lidar,
        *(unknown if pose is None else pose for pose in world),
    )


def flat(image: p2o.Image) -> tuple[UInt8, p2o.Camera]:
    """Return an image (H, W, 3) as a pinhole camera shows it, at most 1280 px wide, black outside the lens."""
    import cv2

    camera, rgb = image.camera, image.rgb
    scale = min(1.0, _WIDEST_PX / camera.width)
    width, height = max(1, round(scale * camera.width)), max(1, round(scale * camera.height))
    if scale < 1.0:
        rgb = np.asarray(cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA))
        camera = camera.resized(width, height)
    shown = p2o.Image(rgb, camera).undistorted()
    return shown.rgb, shown.camera


def labelled_image(sample: Sample) -> UInt8:
    """Draw a sample with its points at the true extrinsic, near ones in warm colours: `p2o labels --draw`."""
    import cv2

    from p2o_baselines.regressors.network_input import nearness

    out = (0.5 * sample.rgb).astype(np.uint8)
    uv = sample.xyz[:, :2] / sample.xyz[:, 2:] * sample.focal + sample.centre
    height, width = out.shape[:2]
    seen = (uv >= 0).all(axis=1) & (uv < [width - 1, height - 1]).all(axis=1)
    order = np.flatnonzero(seen)[np.argsort(-sample.xyz[seen, 2])]
    colour = cv2.applyColorMap((255 * nearness(sample.xyz[order, 2])).astype(np.uint8)[:, None], cv2.COLORMAP_TURBO)
    u, v = np.rint(uv[order]).astype(np.int64).T
    out[v, u] = np.asarray(colour)[:, 0, ::-1]
    return out
