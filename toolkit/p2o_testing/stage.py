"""A bare stage with exact truth, made of numpy alone: upright plates in a room, seen by a camera and a LiDAR.

LiDAR frame: x forward, y left, z up. Plates are rectangles across x, so their outlines are known in closed form. Each
surface has a grey and an intensity of its own, so that the two are related as mutual information wants it.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from p2o.arrays import Float, Int
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.sets import CloudFeatures, CloudPoints, GreyMap, ImageFeatures
from p2o.features.side import Side
from p2o.features.view import View
from p2o.frames.cloud import Cloud
from p2o.frames.frame import Frame
from p2o.frames.image import Image
from p2o.geometry import se3
from p2o.geometry.camera import Camera

BASELINE_M = 0.54
FLOOR_M = -1.7
# Distance, then left, right, top and bottom border of each plate; none hides another, in either sensor.
_PLATES = np.array(
    [
        [7.0, 3.4, 2.2, 0.6, -0.8],
        [8.0, 1.2, 0.1, 0.9, -0.5],
        [9.5, -0.9, -2.2, 0.3, -0.9],
        [11.0, -3.6, -5.0, 1.2, -0.2],
        [12.0, 8.6, 7.0, 1.0, -0.6],
    ]
)
_GREYS = np.array([40.0, 215.0, 45.0, 210.0, 50.0, 125.0, 125.0, 105.0, 140.0, 115.0, 150.0])
_FRONT_M, _BACK_M, _SIDE_M, _CEILING_M = 22.0, -15.0, 12.0, 8.0
# Axis and place of each wall, then of the floor and the ceiling.
_WALLS = ((0, _FRONT_M), (0, _BACK_M), (1, _SIDE_M), (1, -_SIDE_M), (2, FLOOR_M), (2, _CEILING_M))
_BEAMS, _COLUMNS = 64, 1500


@lru_cache(maxsize=1)
def camera() -> Camera:
    """Return the camera of the stage: a pinhole of 480x240 px with a horizontal view of 80 degrees."""
    return Camera.pinhole(286.0, 286.0, 240.3, 118.6, 480, 240)


@lru_cache(maxsize=1)
def camera_from_lidar() -> Float:
    """Return the true extrinsic (4, 4): the camera 0.2 m ahead, 0.1 m left and 0.1 m below, turned by 1.2 deg."""
    axes = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    turn = se3.exp(np.array([0.012, -0.015, 0.009, 0.0, 0.0, 0.0]))[:3, :3]
    truth = se3.make(turn @ axes, -turn @ axes @ np.array([0.2, 0.1, -0.1]))
    truth.flags.writeable = False
    return truth


@lru_cache(maxsize=1)
def frame() -> Frame:
    """Return the stage as a frame: image, right image, exact depth, and a sweep with ring, column, time, intensity."""
    lidar_from_camera = se3.inverse(camera_from_lidar())
    return Frame("stage", _image(lidar_from_camera), _sweep(np.eye(4)), camera_from_lidar=camera_from_lidar())


@lru_cache(maxsize=1)
def stage_from_lidar() -> Float:
    """Return the poses stage_from_lidar (3, 4, 4) of the frames of `drive`; "stage" is the LiDAR frame of `frame`."""
    first, second = [0.03, -0.05, 0.06, -0.5, 0.2, 0.05], [-0.04, 0.02, 0.03, 0.0, 0.1, -0.1]
    poses = se3.exp(np.array([first, second, [0.02, 0.05, -0.07, 0.6, -0.15, 0.02]]))
    poses.flags.writeable = False
    return poses


@lru_cache(maxsize=1)
def drive() -> tuple[Frame, ...]:
    """Return three frames of one sequence: the rig stops at each, a second apart, and both sensors know their poses."""
    camera_from, lidar_from_camera = camera_from_lidar(), se3.inverse(camera_from_lidar())
    # Each sensor has its own world frame: poses contain the motion of the sensors, not the extrinsic.
    worlds = [[0.3, -0.2, 1.1, 20.0, -7.0, 3.0], [-0.8, 0.4, 0.2, -3.0, 12.0, 5.0]]
    lidar_world, camera_world = se3.exp(np.array(worlds))
    return tuple(
        Frame(
            f"stage/{number}",
            _image(pose @ lidar_from_camera),
            _sweep(pose),
            camera_from_lidar=camera_from,
            twist=np.zeros(6),
            sequence="stage",
            time_s=float(number),
            lidar_world_from_lidar=lidar_world @ pose,
            camera_world_from_camera=camera_world @ pose @ lidar_from_camera,
        )
        for number, pose in enumerate(stage_from_lidar())
    )


def distance_m(xyz: Float) -> Float:
    """Return the distances (N,) in m of points (N, 3) of the stage from its nearest surface."""
    x, y, z = (column[:, None] for column in np.transpose(xyz))
    plate_x, left, right, top, bottom = _PLATES.T
    aside = np.maximum(np.maximum(y - left, right - y), 0.0)
    above = np.maximum(np.maximum(z - top, bottom - z), 0.0)
    plates = np.sqrt((x - plate_x) ** 2 + aside**2 + above**2)
    walls = np.column_stack([np.abs(xyz[:, axis] - limit) for axis, limit in _WALLS])
    return np.asarray(np.concatenate([plates, walls], axis=1).min(axis=1))


def featureless_image() -> Image:
    """Return an image without features: one grey, one depth."""
    grey = np.full((240, 480, 3), 128, np.uint8)
    return Image(grey, camera(), right=grey, baseline_m=BASELINE_M, depth_m=np.full((240, 480), 10.0))


def featureless_cloud() -> Cloud:
    """Return a sweep without features: the inside of a sphere of 15 m radius around the LiDAR."""
    return _cloud(15.0, np.full(_BEAMS * _COLUMNS, 0.4))


@lru_cache(maxsize=1)
def view() -> View:
    """Return exact features: the outlines of all plates as edges of both sensors, and all greys and points.

    Edges have their sides, points their intensities and the normals of their surfaces.
    """
    xyz, side, background = _outlines(0.05)
    fine, fine_side, _ = _outlines(0.01)
    uv = camera().project(se3.apply(camera_from_lidar(), fine))
    shown = camera().in_image(uv)
    edges = CloudEdges(xyz, side, sigma_m=np.full(len(xyz), 0.01), background=background)
    return View(
        "stage",
        camera(),
        ImageFeatures(edges=ImageEdges(uv[shown], fine_side[shown]), features=[_grey(frame().image)]),
        CloudFeatures(edges=edges, points=_points()),
    )


def bare_view() -> View:
    """Return a view without features: no edges, one grey, and points of one intensity."""
    cloud = featureless_cloud()
    return View(
        "bare",
        camera(),
        ImageFeatures(edges=ImageEdges.empty(), features=[_grey(featureless_image())]),
        CloudFeatures(edges=CloudEdges.empty(), points=CloudPoints(cloud.xyz, cloud.intensity, -cloud.xyz / 15.0)),
    )


def _grey(image: Image) -> GreyMap:
    return GreyMap(image.grey.astype(np.float64))


def _points() -> CloudPoints:
    """Return every point of the sweep with its intensity and the normal of its surface, towards the LiDAR."""
    cloud, (_, _, directions) = frame().cloud, _beams()
    facing = np.zeros((len(_PLATES) + len(_WALLS), 3))
    facing[: len(_PLATES), 0] = -1.0
    for number, (axis, limit) in enumerate(_WALLS, len(_PLATES)):
        facing[number, axis] = -np.sign(limit)
    return CloudPoints(cloud.xyz, cloud.intensity, facing[_cast(np.zeros(3), directions)[1]])


def _outlines(step_m: float) -> tuple[Float, Any, Float]:
    """Return points (N, 3) along the borders of all plates, their sides (N,) and background directions (N, 3)."""
    points, sides, backgrounds = [], [], []
    for x, left, right, top, bottom in _PLATES:
        across = np.linspace(right, left, round((left - right) / step_m))
        down = np.linspace(bottom, top, round((top - bottom) / step_m))
        for side, y, z, background in (
            (Side.LEFT, np.full_like(down, left), down, (0.0, 1.0, 0.0)),
            (Side.RIGHT, np.full_like(down, right), down, (0.0, -1.0, 0.0)),
            (Side.UPPER, across, np.full_like(across, top), (0.0, 0.0, 1.0)),
            (Side.BOTTOM, across, np.full_like(across, bottom), (0.0, 0.0, -1.0)),
        ):
            points.append(np.column_stack([np.full_like(y, x), y, z]))
            sides.append(np.full(len(y), side, np.int8))
            backgrounds.append(np.tile(background, (len(y), 1)))
    return np.concatenate(points), np.concatenate(sides), np.concatenate(backgrounds)


def _cast(origin: Float, directions: Float) -> tuple[Float, Int]:
    """Return the distance in m and the number of the first surface along rays (N, 3): plates, then walls."""
    with np.errstate(divide="ignore", invalid="ignore"):
        x = (_PLATES[:, 0, None] - origin[0]) / directions[:, 0]
        y, z = origin[1] + x * directions[:, 1], origin[2] + x * directions[:, 2]
        _, left, right, top, bottom = _PLATES.T[:, :, None]
        inside = (y <= left) & (y >= right) & (z <= top) & (z >= bottom)
        walls = np.stack([(limit - origin[axis]) / directions[:, axis] for axis, limit in _WALLS])
    distance = np.concatenate([np.where(inside, x, np.inf), walls])
    distance = np.where(np.isfinite(distance) & (distance > 1e-6), distance, np.inf)
    surface = np.argmin(distance, axis=0)
    return distance[surface, np.arange(len(surface))], surface


def _image(stage_from_camera: Float) -> Image:
    rgb, depth = _render(stage_from_camera)
    right, _ = _render(stage_from_camera @ se3.make(translation=(BASELINE_M, 0.0, 0.0)))
    return Image(rgb, camera(), right=right, baseline_m=BASELINE_M, depth_m=depth)


def _render(lidar_from_camera: Float) -> tuple[Any, Float]:
    """Return rgb (H, W, 3) uint8 and depth (H, W) in metres along the optical axis."""
    height, width = camera().height, camera().width
    uv = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2)
    rays = camera().rays(uv.astype(np.float64))
    directions = rays @ lidar_from_camera[:3, :3].T
    distance, surface = _cast(lidar_from_camera[:3, 3], directions)
    points = lidar_from_camera[:3, 3] + distance[:, None] * directions
    # Each surface has a grey of its own and a texture fixed to it, so that block matching has something to match.
    waves = np.random.default_rng(0).normal(scale=9.0, size=(3, 12))
    grain = np.sin(points @ waves + surface[:, None]).sum(axis=1)
    grey = np.clip(_GREYS[surface] + 7.0 * grain, 0, 255).astype(np.uint8).reshape(height, width)
    return np.repeat(grey[:, :, None], 3, axis=2), (distance * rays[:, 2]).reshape(height, width)


def _beams() -> tuple[Int, Int, Float]:
    """Return ring (N,), column (N,) and unit direction (N, 3) of every firing, ring by ring, highest first."""
    ring, column = (a.ravel() for a in np.mgrid[0:_BEAMS, 0:_COLUMNS])
    elevation = np.radians(8.0 - 28.0 * ring / (_BEAMS - 1))
    azimuth = 2 * np.pi * column / _COLUMNS
    directions = np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    return ring, column, directions


def _sweep(pose: Float) -> Cloud:
    """Return the sweep of a LiDAR at the pose stage_from_lidar (4, 4), in the LiDAR frame."""
    distance, surface = _cast(pose[:3, 3], _beams()[2] @ pose[:3, :3].T)
    return _cloud(distance[:, None], np.asarray(0.1 + 0.08 * (surface % 10), np.float64))


def _cloud(distance_m: Float | float, intensity: Float) -> Cloud:
    """Return the sweep with these distances (N, 1) and intensities (N,)."""
    ring, column, directions = _beams()
    time_s = column / _COLUMNS * 0.1 - 0.05
    return Cloud(distance_m * directions, ring=ring, column=column, intensity=intensity, time_s=time_s)
