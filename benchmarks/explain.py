"""Draw the figures of docs/how-it-works.md and docs/conventions.md: `python benchmarks/explain.py [--out FOLDER]`.

All of them are made by the tool: one synthetic street (`STREET`), calibrated by the default method from 2 deg and 15 cm
off; and what errors of the pose do to the points of a sweep, as `pose_error` names them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import p2o
from p2o.arrays import Float, UInt8
from p2o.draw.overlay import COLOURS, before_after, draw
from p2o.draw.sweep_image import draw_sweep
from p2o.host.method import Kind
from p2o.run.part import part_of
from p2o.run.recipe import open_dataset

STREET = "synthetic:?scenes=1&seed=1&right=false"
START = "2deg 0.15m"
CROP = (880, 100, 210, 250)
"""Left, top, width and height of the piece in which pairs are shown, px."""
RING = 20
SKY_PX = 110
"""Rows above those that the sweep reaches."""
REACH_PX = 30.0
SURE = 0.5
OUT = Path("docs/gallery")


@dataclass(frozen=True)
class Street:
    """A frame with what the extractors found in it, and what the default method made of it."""

    frame: p2o.Frame
    image_edges: p2o.ImageEdges
    cloud_edges: p2o.CloudEdges
    result: p2o.Result

    @classmethod
    def calibrated(cls) -> Street:
        """Calibrate the street and find its edges."""
        registry = p2o.Registry.load()
        [frame] = open_dataset(STREET, registry)
        image = part_of(registry.find(Kind.IMAGE_EXTRACTOR, "p2ornet"), "extractor", {}, 0).build()
        cloud = part_of(registry.find(Kind.CLOUD_EXTRACTOR, "rings"), "cloud", {}, 0).build()
        run = p2o.calibrate(STREET, perturb=START)
        assert run.result is not None
        found, swept = image(frame.image).edges, cloud(frame.cloud).edges
        return cls(frame, found.select(found.weight >= SURE), swept, run.result)

    def view(self) -> p2o.View:
        """Return what matchers see."""
        features = p2o.ImageFeatures(edges=self.image_edges), p2o.CloudFeatures(edges=self.cloud_edges)
        return p2o.View("street", self.frame.camera, *features)


def edges_of_the_image(street: Street) -> UInt8:
    """Return the image above the same image with the edges detected by the network, as lines two pixels wide."""
    rgb = street.frame.image.rgb
    canvas = (0.35 * rgb).astype(np.uint8)
    edges = street.image_edges
    for u, v in ((0, 0), (1, 0), (0, 1), (1, 1)):
        place = np.clip(np.rint(edges.uv).astype(int) + (u, v), 0, np.array(rgb.shape[1::-1]) - 1)
        canvas[place[:, 1], place[:, 0]] = colours(edges.side)
    return before_after(rgb, canvas, titles=("what the camera sees", "what hides what: edges by direction"))


def edges_of_the_sweep(street: Street) -> UInt8:
    """Return the sweep, seen from the camera, above the same with its edges as discs."""
    frame, edges = street.frame, street.cloud_edges
    dark = np.zeros_like(frame.image.rgb)
    points = draw_sweep(dark, frame.cloud, frame.camera, frame.camera_from_lidar)
    canvas = (0.3 * points).astype(np.uint8)
    uv = frame.camera.project(p2o.se3.apply(frame.camera_from_lidar, edges.xyz))
    seen = frame.camera.in_image(uv)
    for place, colour in zip(np.rint(uv[seen]).astype(int), colours(edges.side[seen]), strict=True):
        cv2.circle(canvas, place.tolist(), 3, colour.tolist(), -1, cv2.LINE_AA)
    titles = "what the LiDAR sees, by range", "where its range jumps: edges by direction, on the nearer surface"
    return before_after(points[SKY_PX:], canvas[SKY_PX:], titles=titles)


def ring_of_the_sweep(street: Street, path: Path) -> None:
    """Write the range along one ring, in the camera's view, with its edges."""
    plt = pyplot()
    cloud, edges, camera = street.frame.cloud, street.cloud_edges, street.frame.camera
    truth = street.frame.camera_from_lidar
    row = cloud.ring == RING
    xyz = cloud.xyz[row & camera.in_image(camera.project(p2o.se3.apply(truth, cloud.xyz)))]
    bearing = -np.degrees(np.arctan2(xyz[:, 1], xyz[:, 0]))
    order = np.argsort(bearing)
    fig, ax = plt.subplots(figsize=(9.6, 3.0), dpi=110)
    ax.plot(bearing[order], np.linalg.norm(xyz[order], axis=1), ".-", color="0.35", ms=2.5, lw=0.6)
    height = np.degrees(np.arctan2(edges.xyz[:, 2], np.hypot(edges.xyz[:, 0], edges.xyz[:, 1])))
    level = float(np.median(np.degrees(np.arctan2(xyz[:, 2], np.hypot(xyz[:, 0], xyz[:, 1])))))
    here = (np.abs(height - level) < 0.1) & camera.in_image(camera.project(p2o.se3.apply(truth, edges.xyz)))
    for side in (p2o.Side.LEFT, p2o.Side.RIGHT):
        at = edges.xyz[here & (edges.side == side)]
        if len(at):
            where = -np.degrees(np.arctan2(at[:, 1], at[:, 0]))
            colour = np.array(COLOURS[side.letter]) / 255
            ax.plot(
                where,
                np.linalg.norm(at, axis=1),
                "o",
                ms=8,
                mfc="none",
                mec=colour,
                mew=2.2,
                label=f"{side.letter}: the background begins to the {side.name.lower()}",
            )
    ax.set_yscale("log")
    ax.set_yticks([5, 10, 20, 40, 80], ["5", "10", "20", "40", "80"])
    ax.minorticks_off()
    ax.set_xlabel("bearing, deg (right is positive)")
    ax.set_ylabel("range, m")
    ax.legend(loc="upper right", frameon=False)
    saved(fig, path)


def pairs(street: Street) -> UInt8:
    """Return a crop of the image with its pairs at the initial guess: by direction, and with any nearest edge."""
    panels = []
    for name, title in (("ogm", "paired by direction"), ("nearest", "paired with the nearest, whatever its direction")):
        registry = p2o.Registry.load()
        match = part_of(registry.find(Kind.MATCHER, name), "matcher", {}, 0).build()
        problem = match([street.view()], street.result.start, REACH_PX)
        piece = pairs_drawn(street, problem)
        bar = np.full((26, piece.shape[1], 3), 24, np.uint8)
        cv2.putText(bar, title, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235, 235, 235), 1, cv2.LINE_AA)
        panels.append(np.concatenate([bar, piece]))
    gap = np.full((len(panels[0]), 8, 3), 255, np.uint8)
    return np.concatenate([panels[0], gap, panels[1]], axis=1)


def pairs_drawn(street: Street, problem: Any, scale: int = 3) -> UInt8:
    """Return the piece, enlarged: image edges as squares, points of the sweep as discs, a white line for each pair."""
    left, top, width, height = CROP
    piece = street.frame.image.rgb[top : top + height, left : left + width]
    canvas = cv2.resize((0.3 * piece).astype(np.uint8), None, fx=scale, fy=scale, interpolation=cv2.INTER_NEAREST)

    def place(uv: Float) -> list[tuple[int, int]]:
        return [(round(scale * (u - left + 0.5)), round(scale * (v - top + 0.5))) for u, v in uv]

    edges = street.image_edges
    for (x, y), colour in zip(place(edges.uv), colours(edges.side), strict=True):
        cv2.rectangle(canvas, (x - 1, y - 1), (x + 1, y + 1), colour.tolist(), -1)
    uv = street.frame.camera.project(p2o.se3.apply(street.result.start, problem.xyz))
    # The foot of the point on its line is where the pair pulls it.
    foot = uv - ((uv - problem.centre) * problem.normal).sum(axis=1, keepdims=True) * problem.normal
    for one, other in zip(place(uv), place(foot), strict=True):
        cv2.line(canvas, one, other, (235, 235, 235), 1, cv2.LINE_AA)
    sides = {xyz.tobytes(): side for xyz, side in zip(street.cloud_edges.xyz, street.cloud_edges.side, strict=True)}
    side = np.array([sides[xyz.tobytes()] for xyz in problem.xyz])
    for one, colour in zip(place(uv), colours(side), strict=True):
        cv2.circle(canvas, one, 4, colour.tolist(), -1, cv2.LINE_AA)
        cv2.circle(canvas, one, 5, (235, 235, 235), 1, cv2.LINE_AA)
    return canvas


def poses(street: Street) -> UInt8:
    """Return the overlay at the start and at the result."""
    result, frame = street.result, street.frame
    at = [
        draw(frame.image.rgb, street.image_edges, street.cloud_edges, frame.camera, pose)
        for pose in (result.start, result.camera_from_lidar)
    ]
    size = [p2o.pose_error(pose, frame.camera_from_lidar) for pose in (result.start, result.camera_from_lidar)]
    said = [f"{e.rotation_deg:.2f} deg and {100 * e.translation_m:.1f} cm off the truth" for e in size]
    return before_after(at[0], at[1], titles=(f"the start: {said[0]}", f"the result: {said[1]}"))


def colours(side: Any) -> UInt8:
    """Return the colours (N, 3) of directions; grey where there is none."""
    table = np.array([*(COLOURS[s.letter] for s in p2o.SIDES), (150, 150, 150)], np.uint8)
    return np.asarray(table[side])


def axes_of_the_sensors(path: Path) -> None:
    """Write the drawing of both frames, and of what each error of the pose does to the points of a sweep."""
    plt = pyplot()
    fig = plt.figure(figsize=(10, 9.4), dpi=110)
    grid = fig.add_gridspec(3, 3, height_ratios=(1.4, 1, 1), hspace=0.16, wspace=0.06)
    _draw_frames(fig.add_subplot(grid[0, :]))
    for number, (name, size, unit) in enumerate(ERRORS):
        _draw_error(fig.add_subplot(grid[1 + number // 3, number % 3]), name, size, unit)
    saved(fig, path)


ERRORS = (
    ("pitch", 4.0, "deg"),
    ("yaw", 4.0, "deg"),
    ("roll", 10.0, "deg"),
    ("x", 0.5, "m"),
    ("y", 0.5, "m"),
    ("z", 2.0, "m"),
)
"""What is shown: larger where the same size would move points less."""
CAMERA_FROM_LIDAR = p2o.se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, -0.08, -0.27])
"""The worked number of docs/conventions.md."""
SHOWN_FROM_LIDAR = p2o.se3.make([[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0, -0.9, -1.6])
"""The same with the two apart, so that both can be seen."""


def _draw_frames(ax: Any) -> None:
    """Draw the axes of LiDAR and camera as one sees them from behind on the right."""
    # Columns: where x forward, y left, z up go on the paper.
    paper = np.array([[0.86, -0.55, 0.0], [0.28, 0.30, 1.0]])

    def on_paper(xyz: Float) -> Float:
        return np.asarray(xyz) @ paper.T

    lidar_from_camera = p2o.se3.inverse(SHOWN_FROM_LIDAR)
    sensors = (
        ("LiDAR", np.eye(4), ("x forward", "y left", "z up"), 0.8),
        ("camera", lidar_from_camera, ("x right", "y down", "z forward"), 0.8),
    )
    for name, lidar_from_sensor, axes, length in sensors:
        origin = lidar_from_sensor[:3, 3]
        for axis, label, colour in zip(
            lidar_from_sensor[:3, :3].T, axes, ("#d62728", "#2ca02c", "#1f77b4"), strict=True
        ):
            tail, head = on_paper(origin), on_paper(origin + length * axis)
            style = {"arrowstyle": "-|>", "color": colour, "lw": 2.4, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 18}
            ax.annotate("", head, tail, arrowprops=style, annotation_clip=False)
            end = on_paper(origin + (length + (0.17 if abs(axis[2]) > 0.5 else 0.36)) * axis)
            ax.text(*end, label, color=colour, ha="center", va="center", fontsize=10)
        ax.plot(*on_paper(origin), "o", color="0.15", ms=9)
        ax.text(*(on_paper(origin) + (-0.1, -0.17)), name, ha="right", va="top", fontsize=12, weight="bold")
    _draw_view(ax, on_paper, lidar_from_camera)
    tail, head = on_paper(np.zeros(3)), on_paper(lidar_from_camera[:3, 3])
    ax.annotate("", head, tail, arrowprops={"arrowstyle": "->", "color": "0.4", "ls": "--", "shrinkA": 9, "shrinkB": 9})
    note = (
        "camera_from_lidar takes a point's LiDAR coordinates\nto its camera coordinates:\n"
        "p_camera = camera_from_lidar @ p_lidar\n\n"
        "Below, in the image: where points of a sweep fall at\nthe true extrinsic (circles), and at one that is wrong\n"
        "by so much (arrow heads).\nOrange: 8 m away; blue: 40 m."
    )
    ax.text(3.25, -0.1, note, fontsize=10, va="center")
    ax.set_xlim(-1.0, 7.2)
    ax.set_ylim(-1.7, 1.15)
    ax.set_aspect("equal")
    ax.axis("off")


def _draw_view(ax: Any, on_paper: Any, lidar_from_camera: Float) -> None:
    """Draw what the camera sees as a pyramid that opens along its z axis."""
    corner = np.array([[-0.6, -0.36, 1.5], [0.6, -0.36, 1.5], [0.6, 0.36, 1.5], [-0.6, 0.36, 1.5]])
    base = on_paper(p2o.se3.apply(lidar_from_camera, corner))
    tip = on_paper(lidar_from_camera[:3, 3])
    for one, other in zip(base, np.roll(base, -1, axis=0), strict=True):
        ax.plot(*np.transpose([one, other]), color="0.65", lw=1)
        ax.plot(*np.transpose([tip, one]), color="0.65", lw=0.7)


def _draw_error(ax: Any, name: str, size: float, unit: str) -> None:
    """Draw where points fall at the truth, and where they fall when the extrinsic is wrong by `size` on one axis."""
    camera = p2o.Camera.pinhole(700, 700, 450, 300, 900, 600)
    wrong = wrong_by(name, size)
    error = p2o.pose_error(wrong, CAMERA_FROM_LIDAR)
    assert np.isclose(error.per_axis[f"{name}_{unit}"], size)
    lidar_from_camera = p2o.se3.inverse(CAMERA_FROM_LIDAR)
    for depth_m, colour in ((8.0, "#d95f02"), (40.0, "#1f78b4")):
        u, v = np.meshgrid(np.linspace(90, 690, 4), np.linspace(90, 510, 3))
        uv = np.column_stack([u.ravel(), v.ravel()]) + (0 if depth_m < 20 else 100, 0)
        rays = camera.rays(uv)
        xyz = p2o.se3.apply(lidar_from_camera, rays * depth_m / rays[:, 2:])
        moved = camera.project(p2o.se3.apply(wrong, xyz))
        ax.plot(*uv.T, "o", ms=3, mfc="none", mec=colour)
        ax.quiver(
            *uv.T, *(moved - uv).T, angles="xy", scale_units="xy", scale=1, color=colour, width=0.009, headwidth=4
        )
    ax.set_xlim(0, 900)
    ax.set_ylim(600, 0)
    ax.set_aspect("equal")
    ax.set_xticks([])
    ax.set_yticks([])
    about = {"pitch": " (about x)", "yaw": " (about y)", "roll": " (about z)"}.get(name, "")
    ax.set_title(f"{name} {size:+g} {unit}{about}", fontsize=10)


def wrong_by(name: str, size: float) -> Float:
    """Return the worked extrinsic with an error on one axis alone, as `pose_error` names it (deg or m)."""
    turn, shift = np.zeros(3), np.zeros(3)
    if name in ("pitch", "yaw", "roll"):
        turn[("pitch", "yaw", "roll").index(name)] = np.radians(size)
    else:
        shift["xyz".index(name)] = size
    lidar_from_camera_axes = CAMERA_FROM_LIDAR[:3, :3].T
    rotation = p2o.se3.exp(np.r_[lidar_from_camera_axes @ turn, 0, 0, 0])[:3, :3]
    return np.asarray(CAMERA_FROM_LIDAR @ p2o.se3.make(rotation, lidar_from_camera_axes @ shift))


def pyplot() -> Any:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def saved(fig: Any, path: Path) -> None:
    # Omit the version of matplotlib, so that the same figure gives the same file.
    fig.savefig(path, bbox_inches="tight", metadata={"Software": None})
    pyplot().close(fig)


def written(path: Path, rgb: UInt8, quality: int = 65) -> None:
    cv2.imwrite(str(path), rgb[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])


def main(words: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=OUT, help="write the pictures into this folder")
    out: Path = parser.parse_args(words).out
    out.mkdir(parents=True, exist_ok=True)
    axes_of_the_sensors(out / "axes.png")
    street = Street.calibrated()
    written(out / "how-image-edges.jpg", edges_of_the_image(street))
    written(out / "how-sweep-edges.jpg", edges_of_the_sweep(street), quality=58)
    ring_of_the_sweep(street, out / "how-ring.png")
    written(out / "how-pairs.jpg", pairs(street))
    written(out / "how-before-after.jpg", poses(street))


if __name__ == "__main__":
    main()
