"""Draw edges of both sensors, or the sweep, over a darkened image."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from p2o.arrays import Float, Int, Int8, UInt8, checked
from p2o.errors import InputError
from p2o.features.edges import CloudEdges, ImageEdges
from p2o.features.side import Side
from p2o.files.whole_file import write_whole
from p2o.frames.cloud import Cloud
from p2o.geometry import se3
from p2o.geometry.camera import Camera

COLOURS: Mapping[str, tuple[int, int, int]] = {
    "L": (40, 220, 60),
    "R": (255, 60, 50),
    "U": (255, 225, 40),
    "B": (70, 130, 255),
}
"""RGB of the four directions, as in the paper: L green, R red, U yellow, B blue."""
IMAGE_NONE = (255, 255, 255)
"""Image edges without a direction are white."""
CLOUD_NONE = (255, 70, 255)
"""LiDAR edges without a direction are magenta."""

_RADIUS_PX = 3.0
_NEAR_M, _FAR_M = 4.0, 80.0
_LEGEND_PX, _LEGEND_HIGH_PX, _GAMMA_PX = 330, 60, 190
_PX_A_UNIT = 800
"""Width above which texts are enlarged, because pages scale wide images down."""
_DARK, _LEGIBLE = 0.22, 0.4
"""Mean grey below which an image is brightened, and the target mean grey; black is 0 and white 1."""
_LEAST_GAMMA = 0.35
_DIMMED = 0.65
"""Brightness of the background of an overlay relative to the image."""
_GREY = np.array([0.299, 0.587, 0.114], np.float32)


def draw(
    rgb: UInt8,
    image_edges: ImageEdges,
    cloud_edges: CloudEdges,
    camera: Camera,
    camera_from_lidar: Float,
    *,
    legend: bool = True,
    size: float = 1.0,
) -> UInt8:
    """Return (H, W, 3): image edges as pixels and LiDAR edges, projected at a pose (4, 4), as rings.

    `size` enlarges both, for images of more pixels than the edges were extracted from.

    The opacity of image edges is their confidence. The colour is the direction (`COLOURS`). At a correct pose, rings
    have a line of the same colour through their centre. LiDAR edges outside of the image are left out.

    Raises InputError if the image does not fit the camera.
    """
    canvas = dimmed(rgb, camera)
    _stamp_faded(canvas, image_edges, max(1, math.ceil(size - 0.1)))
    uv = camera.project(se3.apply(camera_from_lidar, cloud_edges.xyz))
    seen = camera.in_image(uv)
    centre, colours = np.rint(uv[seen]).astype(np.int64), _colours(cloud_edges.side[seen], CLOUD_NONE)
    stamp(canvas, centre, _ring(_RADIUS_PX * size, max(1.0, size)), colours)
    if legend:
        _write_legend(canvas)
    return canvas


def draw_cloud(rgb: UInt8, cloud: Cloud, camera: Camera, camera_from_lidar: Float) -> UInt8:
    """Return (H, W, 3): the points of a sweep at a pose (4, 4), from red (near) to blue (far, on a scale of 1/depth).

    Raises InputError if the image does not fit the camera.
    """
    import cv2

    canvas = dimmed(rgb, camera)
    xyz = se3.apply(camera_from_lidar, cloud.xyz)
    uv = camera.project(xyz)
    seen = np.flatnonzero(camera.in_image(uv))
    seen = seen[np.argsort(-xyz[seen, 2], kind="stable")]  # near points last, on top
    closeness = (1 / xyz[seen, 2] - 1 / _FAR_M) / (1 / _NEAR_M - 1 / _FAR_M)
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    colours = table[np.clip(np.sqrt(np.clip(closeness, 0, 1)) * 255, 0, 255).astype(np.int64)]
    dot = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    stamp(canvas, np.rint(uv[seen]).astype(np.int64), dot, colours)
    return canvas


def before_after(before: UInt8, after: UInt8, *, titles: tuple[str, str] = ("before", "after")) -> UInt8:
    """Return two images (H, W, 3) stacked vertically, each below a title bar; raises InputError if sizes differ."""
    if np.shape(before) != np.shape(after):
        raise InputError("the two images differ in size", expected=np.shape(before), got=np.shape(after))
    rows = []
    for image, title in zip((before, after), titles, strict=True):
        bar = np.full((22, image.shape[1], 3), 24, np.uint8)
        _write(bar, title, (8, 16))
        rows += [bar, image]
    return np.concatenate(rows)


def write_png(path: Path | str, rgb: UInt8) -> None:
    """Write an image (H, W, 3) uint8 as PNG; raises InputError for other arrays and if the file cannot be written."""
    import cv2

    image = checked("the image", rgb, (None, None, 3), np.uint8)
    if image.size == 0:
        raise InputError("the image has no pixels", where=path, got=image.shape)
    _, data = cv2.imencode(".png", image[..., ::-1])
    write_whole(path, data.tobytes())


def dimmed(rgb: UInt8, camera: Camera) -> UInt8:
    """Return a darkened copy with low saturation as background.

    A dark image is brightened first; the gamma is written in the upper right corner. Raises InputError if the image
    does not fit the camera.
    """
    given = checked("the image", rgb, (camera.height, camera.width, 3), np.uint8)
    gamma = display_gamma(given)
    bright = brightened(given, gamma).astype(np.float32)
    grey = bright @ _GREY
    canvas = np.asarray(_DIMMED * (0.75 * grey[..., None] + 0.25 * bright), np.uint8)
    if gamma != 1 and camera.width >= _LEGEND_PX + _GAMMA_PX and camera.height >= _LEGEND_HIGH_PX:
        unit = _unit(canvas)
        left = camera.width - round(unit * _GAMMA_PX)
        canvas[round(4 * unit) : round(26 * unit), left : -round(4 * unit)] //= 4
        place = left + round(8 * unit), round(19 * unit)
        _write(canvas, f"brightened: gamma {gamma:.2f}", place, unit=unit)
    return canvas


def display_gamma(rgb: UInt8) -> float:
    """Return the display gamma of an image (H, W, 3): 1 if it is not dark, or completely black."""
    mean = float((rgb[::4, ::4].astype(np.float32) @ _GREY).mean()) / 255 if rgb.size else 0.0
    if not 0 < mean < _DARK:
        return 1.0
    return max(_LEAST_GAMMA, round(math.log(_LEGIBLE) / math.log(mean), 2))


def brightened(rgb: UInt8, gamma: float) -> UInt8:
    """Return the image with values v in 0 to 1 replaced by v ** gamma."""
    if gamma == 1:
        return rgb
    table = np.rint(255 * (np.arange(256) / 255) ** gamma).astype(np.uint8)
    return np.asarray(table[rgb])


def _colours(side: Int8, none: tuple[int, int, int]) -> UInt8:
    """Return the colour (N, 3) of each direction; Side.NONE is -1, the last row."""
    table = np.array([*(COLOURS[s.letter] for s in (Side.LEFT, Side.RIGHT, Side.UPPER, Side.BOTTOM)), none], np.uint8)
    return np.asarray(table[side])


def _ring(radius_px: float, line_px: float = 1.0) -> Int:
    """Return the pixel offsets (K, 2) of a circle."""
    reach = int(np.ceil(radius_px + line_px / 2))
    offset = np.stack(np.meshgrid(np.arange(-reach, reach + 1), np.arange(-reach, reach + 1)), -1).reshape(-1, 2)
    return np.asarray(offset[np.abs(np.hypot(*offset.T) - radius_px) < line_px / 2])


def stamp(canvas: UInt8, centre: Int, offsets: Int, colours: UInt8) -> None:
    """Paint the offsets (K, 2) around every centre (N, 2) in its colour (N, 3), clipped to the canvas."""
    height, width = canvas.shape[:2]
    u, v = np.moveaxis(centre[:, None] + offsets, -1, 0)
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    rows = np.nonzero(inside)[0]
    canvas[v[inside], u[inside]] = colours[rows]


def _stamp_faded(canvas: UInt8, edges: ImageEdges, side_px: int) -> None:
    """Paint image edges as squares with their confidence as opacity; at one pixel the most confident edge wins."""
    order = np.repeat(np.argsort(edges.weight, kind="stable"), side_px**2)
    square = np.stack(np.meshgrid(np.arange(side_px), np.arange(side_px)), -1).reshape(-1, 2) - (side_px - 1) // 2
    u, v = (np.rint(edges.uv[order]).astype(np.int64) + np.tile(square, (len(edges), 1))).T
    inside = (u >= 0) & (v >= 0) & (u < canvas.shape[1]) & (v < canvas.shape[0])
    u, v, order = u[inside], v[inside], order[inside]
    strength = np.clip(edges.weight[order], 0, 1)[:, None]
    ground = canvas[v, u]
    canvas[v, u] = np.rint(ground + strength * (_colours(edges.side[order], IMAGE_NONE) - ground.astype(np.float64)))


def _unit(canvas: UInt8) -> float:
    """Return the scale of texts."""
    return max(1.0, float(canvas.shape[1]) / _PX_A_UNIT)


def _write(
    canvas: UInt8,
    text: str,
    place: tuple[int, int],
    colour: tuple[int, int, int] = (235, 235, 235),
    *,
    unit: float = 1.0,
) -> None:
    import cv2

    cv2.putText(canvas, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.42 * unit, colour, max(1, int(unit)), cv2.LINE_AA)


def _write_legend(canvas: UInt8) -> None:
    """Write the legend into the top left corner, if there is enough space."""
    width = _LEGEND_PX
    if canvas.shape[0] < _LEGEND_HIGH_PX or canvas.shape[1] < width:
        return
    import cv2

    unit = _unit(canvas)
    white = np.full((1, 3), 235, np.uint8)

    def at(*lengths: float) -> list[int]:
        return [round(unit * length) for length in lengths]

    top, low, left, right, base, middle = at(4, 26, 4, width, 19, 15)
    last = "LiDAR edge, projected"
    words_px = cv2.getTextSize(last, cv2.FONT_HERSHEY_SIMPLEX, 0.42 * unit, max(1, int(unit)))[0][0]
    canvas[top:low, left : max(right, at(212)[0] + words_px)] //= 4
    for place, (letter, colour) in zip(range(12, 80, 17), COLOURS.items(), strict=False):
        _write(canvas, letter, (at(place)[0], base), colour, unit=unit)
    begin, end, first, ring, second = at(84, 98, 104, 196, 206)
    canvas[middle : middle + max(1, round(unit)), begin:end] = white
    _write(canvas, "image edge", (first, base), unit=unit)
    stamp(canvas, np.array([[ring, middle]]), _ring(_RADIUS_PX * unit), white)
    _write(canvas, last, (second, base), unit=unit)
