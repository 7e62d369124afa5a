"""Methods of balls and boxes over the number of poses, and targetless p2o beside them: docs/comparison-targets.md.

    python benchmarks/bodies.py [--rig sphere-vlp16 ...] [--kept FOLDER]

As benchmarks/boards.py: frames are drawn at random (seed 0), the start is off by 5 deg and 30 cm (2 deg and 10 cm for
targetless p2o); the columns of the table are the same. `--draw FILE` draws what is found in the first frames of a
simulated rig of balls and one of boxes instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from boards import DRAWS, POSES, row, solve
from p2o import Calibrator, Frame, Method, Registry, se3
from p2o.arrays import Float
from p2o.cache import FeatureCache, content_hash
from p2o.run.recipe import Recipe
from p2o_baselines.bodies.box_pairing import paired_boxes
from p2o_baselines.targets import gong, kuemmerle, pusztai

METHODS = {"sphere": (kuemmerle.METHOD,), "box": (pusztai.METHOD, gong.METHOD)}
FREE_POSES = 5
_YARD = "place=yard&frames_per_scene=20&right=false&width_px=1242&height_px=700&seed=1"
RIGS = {
    f"{kind}-{name}": f"synthetic:?targets={kind}&lidar={lidar}&{_YARD}"
    for kind in METHODS
    for name, lidar in (("vlp16", "vlp-16"), ("hdl64", "hdl-64e"), ("os1", "os1-64"))
}
_SIDE_PX = 520


def sights(rig: str, kept: Path) -> tuple[list[Any], Float]:
    """Return what the frames of a rig show, kept in a folder, and the truth camera_from_lidar (4, 4)."""
    data, cache = RIGS[rig], FeatureCache(kept)
    dataset = Recipe.of(data=data).resolve(Registry.load()).dataset()
    stage = _built(METHODS[rig.split("-")[0]][0])
    out, truth = [], np.eye(4)
    for number in range(len(dataset)):
        key = content_hash(["bodies", data, number])
        found = cache.get(key)
        if found is None:
            frame = dataset[number]
            cache.put(key, (stage.prepare(frame), frame.camera_from_lidar), 0.0)
            found = cache.get(key)
        assert found is not None
        sight, truth = found.features
        out.append(sight)
    return out, truth


def _built(method: Method) -> Calibrator:
    return method.build(method.options())


def bodies(rig: str, kept: Path) -> None:
    """Print the rows of the methods of a rig."""
    found, truth = sights(rig, kept)
    pictures, sweeps = sum(bool(s.in_image) for s in found), sum(bool(s.in_sweep) for s in found)
    print(f"<!-- {rig}: {pictures} pictures and {sweeps} sweeps of {len(found)} show bodies -->", flush=True)
    for method in METHODS[rig.split("-")[0]]:
        for poses in POSES:
            results = solve(_built(method), found, truth, poses, DRAWS, "5deg 0.3m")
            print(row(rig, method.name, poses, results, truth), flush=True)


def targetless(rig: str) -> None:
    """Print the row of targetless p2o, on one draw of five frames."""
    plan = Recipe.of(data=RIGS[rig], options={"extractor": {"weights": "kitti"}}).resolve(Registry.load())
    dataset, pipeline = plan.dataset(), plan.calibrator()
    chosen = np.sort(np.random.default_rng(0).choice(len(dataset), FREE_POSES, replace=False))
    frames: Sequence[Frame] = [dataset[number] for number in chosen]
    views = [pipeline.prepare(frame) for frame in frames]
    truth = frames[0].camera_from_lidar
    assert truth is not None
    print(row(rig, "targetless p2o", FREE_POSES, solve(pipeline, views, truth, FREE_POSES, 1, "2deg 0.1m"), truth))


class Crop:
    """A square piece of an image, made larger, and where places of the image are in it."""

    def __init__(self, frame: Frame, uv: Float) -> None:
        import cv2

        middle, half = (uv.max(axis=0) + uv.min(axis=0)) / 2, 0.7 * np.ptp(uv, axis=0).max()
        scale = _SIDE_PX / (2 * half)
        self.into = np.array([[scale, 0, scale * (half - middle[0])], [0, scale, scale * (half - middle[1])]])
        bright = np.clip(1.3 * frame.image.rgb, 0, 255).astype(np.uint8)
        self.canvas = cv2.warpAffine(bright, self.into, (_SIDE_PX, _SIDE_PX), flags=cv2.INTER_CUBIC)

    def __call__(self, uv: Float) -> Float:
        return np.asarray(uv @ self.into[:, :2].T + self.into[:, 2])


def draw(path: Path) -> None:
    """Draw a ball and a box in image and sweep: green by the image, blue and orange by the sweep, at the truth.

    On the left on the image; on the right the sweep alone, the ball from its left, the box from the LiDAR.
    """
    import cv2

    def frame_of(kind: str) -> Frame:
        return Recipe.of(data=RIGS[f"{kind}-hdl64"]).resolve(Registry.load()).dataset()[1]

    def dots(canvas: Any, uv: Float, colour: tuple[int, int, int], size: int) -> None:
        for u, v in uv:
            cv2.circle(canvas, (round(float(u)), round(float(v))), size, colour, -1, cv2.LINE_AA)

    def line(canvas: Any, uv: Float, colour: tuple[int, int, int], closed: bool, wide: int = 2) -> None:
        cv2.polylines(canvas, [np.rint(uv).astype(np.int32)], closed, colour, wide, cv2.LINE_AA)

    blues = ((40, 140, 255), (60, 200, 220), (120, 90, 255))
    orange, green = (255, 160, 0), (60, 255, 60)
    turn = np.linspace(0, 2 * np.pi, 120, endpoint=False)

    frame = frame_of("sphere")
    truth, camera = frame.camera_from_lidar, frame.camera
    assert truth is not None
    sight = _built(kuemmerle.METHOD).prepare(frame)
    ball, there = (
        sight.in_image[0],
        min(
            sight.in_sweep,
            key=lambda s: float(np.linalg.norm(se3.apply(truth, s.centre[None])[0] - sight.in_image[0].centre)),
        ),
    )
    middle = se3.apply(truth, there.centre[None])[0]
    half = np.arcsin(there.radius_m / np.linalg.norm(middle))
    axis = middle / np.linalg.norm(middle)
    side = np.cross(axis, [0.0, 1.0, 0.0]) / np.linalg.norm(np.cross(axis, [0.0, 1.0, 0.0]))
    around = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
    cone = camera.project(np.cos(half) * axis + np.sin(half) * around)
    crop = Crop(frame, cone)
    dots(crop.canvas, crop(camera.project(se3.apply(truth, there.xyz))), blues[0], 2)
    line(crop.canvas, crop(cone), orange, True, 1)
    dots(crop.canvas, crop(camera.project(ball.rays)), green, 2)
    beside = np.full((_SIDE_PX, _SIDE_PX, 3), 255, np.uint8)
    ahead = there.centre * [1.0, 1.0, 0.0] / np.linalg.norm(there.centre[:2])

    def from_left(xyz: Float) -> Float:
        off = xyz - there.centre
        return np.column_stack([off @ ahead, -off[:, 2]]) * _SIDE_PX / (3 * there.radius_m) + _SIDE_PX / 2

    circle = there.centre + there.radius_m * (np.cos(turn)[:, None] * ahead + np.sin(turn)[:, None] * np.eye(3)[2])
    dots(beside, from_left(there.xyz), blues[0], 2)
    line(beside, from_left(circle), orange, True)
    top = np.concatenate([crop.canvas, beside], axis=1)

    frame = frame_of("box")
    truth, camera = frame.camera_from_lidar, frame.camera
    assert truth is not None
    pairing = paired_boxes([_built(pusztai.METHOD).prepare(frame)], truth)
    assert pairing is not None
    pair = pairing.pairs[0]
    outline = pair.image.target.outline
    edges = [(a, a ^ bit) for a in range(8) for bit in (1, 2, 4) if a < a ^ bit]
    in_picture = camera.project(se3.apply(truth @ pair.lidar_from_box, outline))
    crop = Crop(frame, in_picture)
    ahead = pair.lidar_from_box[:3, 3] / np.linalg.norm(pair.lidar_from_box[:3, 3])
    right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(ahead, [0.0, 0.0, 1.0]))
    beside = np.full((_SIDE_PX, _SIDE_PX, 3), 255, np.uint8)

    def from_lidar(xyz: Float) -> Float:
        off = xyz - pair.lidar_from_box[:3, 3]
        return np.column_stack([off @ right, off @ np.cross(ahead, right)]) * _SIDE_PX / 1.5 + _SIDE_PX / 2

    for face, colour in zip(pair.sweep.faces, blues, strict=True):
        dots(crop.canvas, crop(camera.project(se3.apply(truth, face.xyz))), colour, 1)
        dots(beside, from_lidar(face.xyz), colour, 2)
    near = int(np.linalg.norm(se3.apply(pair.lidar_from_box, outline), axis=1).argmax())
    for a, b in edges:
        if near not in (a, b):  # those of the far corner are hidden
            line(crop.canvas, crop(in_picture[[a, b]]), orange, False, 1)
            line(beside, from_lidar(se3.apply(pair.lidar_from_box, outline[[a, b]])), orange, False)
    if pair.image.edges is not None:
        for edge in pair.image.edges:
            ends = pair.image.flat.rays(np.array([edge.at - 25 * edge.along, edge.at + 25 * edge.along]))
            line(crop.canvas, crop(camera.project(ends)), green, False)
    dots(crop.canvas, crop(camera.project(pair.image.corner_rays)), green, 5)
    both = np.concatenate([top, np.concatenate([crop.canvas, beside], axis=1)])
    cv2.imwrite(str(path), both[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", nargs="*", choices=RIGS, help="names of rigs (default: all)")
    parser.add_argument("--kept", type=Path, default=Path("build/bodies-kept"), help="folder of what was found")
    parser.add_argument("--only", choices=("bodies", "targetless"), help="leave the other rows out")
    parser.add_argument("--draw", type=Path, help="draw a ball and a box into this file instead")
    arguments = parser.parse_args()
    if arguments.draw is not None:
        draw(arguments.draw)
        return
    print(
        "| rig | method | poses | refused | deg, mean / median | cm, mean / median | coverage (67 %) | mean by axis |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for rig in arguments.rig or RIGS:
        if arguments.only != "targetless":
            bodies(rig, arguments.kept)
        if arguments.only != "bodies":
            targetless(rig)


if __name__ == "__main__":
    main()
