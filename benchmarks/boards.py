"""Compare methods with boards by the number of board poses, and targetless p2o: docs/comparison-targets.md.

    python benchmarks/boards.py [--rig vlp16-1 ...] [--real build/data/rigs] [--kept FOLDER]

For every rig, method and number of poses: frames are drawn at random (seed 0), the start is off by 5 deg and 30 cm (2
deg and 10 cm for targetless p2o). Printed are means and medians of errors, how many were refused, of how many two of
three bounds of the predicted error covered it, and the mean error about and along each axis of the camera.
`--draw FILE` draws
what is found in the first frame of a simulated rig instead.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Checkerboard, Frame, Registry, Result, pose_error, se3
from p2o.arrays import Float
from p2o.cache import FeatureCache, content_hash
from p2o.geometry.perturb import parse_perturbation
from p2o.run.recipe import Recipe
from p2o_baselines.boards.holes_in_sweep import HoleBoardInSweep
from p2o_baselines.boards.pairing import paired
from p2o_baselines.target_method import Sight
from p2o_baselines.targets import acsc, domhof, geiger, koo, mirzaei, velas, velo2cam, zhou

METHODS = {
    "boards": {"zhou": zhou.METHOD, "koo": koo.METHOD, "geiger": geiger.METHOD, "mirzaei": mirzaei.METHOD},
    "squares": {"acsc": acsc.METHOD},
    "holes": {"velo2cam": velo2cam.METHOD, "domhof": domhof.METHOD, "velas": velas.METHOD},
}
"""Methods by what is prepared for them."""
FINDERS = {"boards": zhou.METHOD, "squares": acsc.METHOD, "holes": velas.METHOD}
POSES, DRAWS = (1, 2, 3, 5, 10, 20), 10
FREE_POSES, FREE_DRAWS = (1, 5, 20), (5, 2, 1)
ACFR_BOARD = Checkerboard(5, 7, 0.095, 0.61, 0.85)
_SIDE_PX = 560
_HOLES = "synthetic:?targets=holes&exposure_ev=0&place=yard&frames_per_scene=20&right=false&width_px=1242&height_px=700"
_YARD = "synthetic:?targets=checkerboard&place=yard&frames_per_scene=20&right=false&width_px=1242&height_px=700"


@dataclass(frozen=True)
class BoardRig:
    """One pair of sensors: its frames, the board that they show where they do not say it, and its weights."""

    data: str
    board: Checkerboard | None = None
    weights: str = "kitti"
    kinds: tuple[str, ...] = ("boards", "squares")

    def frame(self, frame: Frame) -> Frame:
        """Return the frame, with what it shows."""
        return frame if self.board is None else replace(frame, targets=(self.board,))


def rigs(real: Path) -> dict[str, BoardRig]:
    """Return the rigs by name; real ones only where they are there."""
    found = {
        f"{name}-{seed}": BoardRig(f"{_YARD}&lidar={lidar}&seed={seed}")
        for name, lidar in (("vlp16", "vlp-16"), ("hdl64", "hdl-64e"))
        for seed in (1, 2)
    }
    found |= {
        f"holes-{name}-{seed}": BoardRig(f"{_HOLES}&lidar={lidar}&seed={seed}", kinds=("holes",))
        for name, lidar in (("vlp16", "vlp-16"), ("hdl64", "hdl-64e"), ("os1", "os1-64"))
        for seed in (2,)
    }
    if (real / "acfr_vlp16").is_dir():
        found = {"acfr_vlp16": BoardRig(f"folder:{real / 'acfr_vlp16'}", ACFR_BOARD), **found}
    return found


@dataclass(frozen=True, eq=False)
class Prepared:
    """What a stage found in each frame, and the truth camera_from_lidar (4, 4)."""

    found: list[Any]
    truth: Float


def prepared(rig: BoardRig, kept: Path, kind: str, stage: Any, frames: int | None = None) -> Prepared:
    """Return the results of a stage for the frames of a rig, or for N of them; cached in a folder, by `kind`."""
    dataset = Recipe.of(data=rig.data).resolve(Registry.load()).dataset()
    cache = FeatureCache(kept)
    out, truth = [], np.eye(4)
    for number in range(len(dataset) if frames is None else frames):
        key = content_hash([kind, rig.data, number])
        found = cache.get(key)
        if found is None:
            frame = rig.frame(dataset[number])
            cache.put(key, (stage.prepare(frame), frame.camera_from_lidar), 0.0)
            found = cache.get(key)
        assert found is not None
        seen, truth = found.features
        out.append(seen)
    return Prepared(out, truth)


def sight_in(found: Any) -> Sight:
    """Return the boards in what a stage found."""
    return found if isinstance(found, Sight) else found.sight  # type: ignore[no-any-return]


def row(name: str, method: str, poses: int, results: Sequence[Result], truth: Float) -> str:
    """Return a line of the table."""
    solved = [result for result in results if result.status.solved]
    head = f"| {name} | {method} | {poses} | {len(results) - len(solved)} of {len(results)} |"
    if not solved:
        return head + "  |  |  |  |"
    errors = [pose_error(result.camera_from_lidar, truth) for result in solved]
    deg, cm = np.array([e.rotation_deg for e in errors]), 100 * np.array([e.translation_m for e in errors])
    pairs = [(e, r.accuracy) for e, r in zip(errors, solved, strict=True) if r.accuracy is not None]
    held = [
        sum(e.rotation_deg <= a.rotation_deg for e, a in pairs),
        sum(e.translation_m <= a.translation_m for e, a in pairs),
    ]
    axes = {k: float(np.mean([e.per_axis[k] for e in errors])) for k in errors[0].per_axis}
    turn = " / ".join(f"{axes[k]:+.2f}" for k in ("pitch_deg", "yaw_deg", "roll_deg"))
    shift = " / ".join(f"{100 * axes[k]:+.1f}" for k in ("x_m", "y_m", "z_m"))
    return (
        f"{head} {deg.mean():.2f} / {np.median(deg):.2f} | {cm.mean():.1f} / {np.median(cm):.1f} | "
        f"{held[0]}, {held[1]} of {len(pairs)} | {turn}, {shift} |"
    )


def solve(stage: Any, found: Sequence[Any], truth: Float, poses: int, draws: int, start: str) -> list[Result]:
    """Return the results of N random samples of frames; of one if it contains all frames."""
    rng = np.random.default_rng(0)
    out = []
    for _ in range(1 if poses == len(found) else draws):
        chosen = np.sort(rng.choice(len(found), poses, replace=False))
        at = parse_perturbation(start).start(truth, rng)
        out.append(stage.solve([found[number] for number in chosen], at))
    return out


def boards(name: str, rig: BoardRig, kept: Path, methods: Sequence[str]) -> None:
    """Print the rows of the methods of boards."""
    for kind in rig.kinds:
        offers = {method: offer for method, offer in METHODS[kind].items() if method in methods}
        if not offers:
            continue
        found = prepared(rig, kept, kind, FINDERS[kind].build(FINDERS[kind].options()))
        sights = [sight_in(each) for each in found.found]
        seen, pieces = sum(bool(s.in_image) for s in sights), sum(bool(s.in_sweep) for s in sights)
        print(f"<!-- {name}: {seen} pictures and {pieces} sweeps of {len(sights)} show {kind} -->", flush=True)
        for method, offered in offers.items():
            stage = offered.build(offered.options())
            own = sights if kind == "holes" and method != "velas" else found.found
            for poses in [count for count in POSES if count <= len(own)]:
                results = solve(stage, own, found.truth, poses, DRAWS, "5deg 0.3m")
                print(row(name, method, poses, results, found.truth), flush=True)


def targetless(name: str, rig: BoardRig, kept: Path, few: bool) -> None:
    """Print the rows of targetless p2o; only that of five poses, of the first five frames, with `few`."""
    plan = Recipe.of(data=rig.data, options={"extractor": {"weights": rig.weights}}).resolve(Registry.load())
    pipeline = plan.calibrator()
    found = prepared(rig, kept, "p2o", pipeline, 5 if few else None)
    for poses, draws in zip((5,) if few else FREE_POSES, (1,) if few else FREE_DRAWS, strict=True):
        results = solve(pipeline, found.found, found.truth, poses, draws, "2deg 0.1m")
        print(row(name, "targetless p2o", poses, results, found.truth), flush=True)


def draw(rig: BoardRig, path: Path, number: int) -> None:
    """Draw what is found of a board: corners and axes in the image, points, ends and outline of the sweep in both.

    On the left all on the image, at the truth; on the right the sweep alone, seen along the board's normal.
    """
    import cv2

    frame = rig.frame(Recipe.of(data=rig.data).resolve(Registry.load()).dataset()[number])
    truth, camera = frame.camera_from_lidar, frame.camera
    assert truth is not None
    finder = FINDERS[rig.kinds[0]]
    pairing = paired([sight_in(finder.build(finder.options()).prepare(frame))], truth)
    assert pairing is not None
    pair = pairing.pairs[0]
    board, patch = pair.board, pair.patch
    outline = camera.project(se3.apply(board.camera_from_board, board.target.outline))
    middle, half = (outline.max(axis=0) + outline.min(axis=0)) / 2, 0.75 * np.ptp(outline, axis=0).max()
    scale = _SIDE_PX / (2 * half)
    shrunk = np.array([[scale, 0, scale * (half - middle[0])], [0, scale, scale * (half - middle[1])]])
    bright = np.clip(1.4 * frame.image.rgb, 0, 255).astype(np.uint8)
    left = cv2.warpAffine(bright, shrunk, (_SIDE_PX, _SIDE_PX), flags=cv2.INTER_CUBIC)
    right = np.full((_SIDE_PX, _SIDE_PX, 3), 255, np.uint8)
    per_m = _SIDE_PX / (1.5 * max(patch.size_m))

    def seen(xyz: Float) -> Float:
        return np.asarray(camera.project(se3.apply(truth, xyz)) @ shrunk[:, :2].T + shrunk[:, 2])

    def along(xyz: Float) -> Float:
        own = se3.apply(se3.inverse(pair.lidar_from_board), xyz)
        return np.asarray(own[:, :2] * per_m + _SIDE_PX / 2)

    def dots(canvas: Any, uv: Float, colour: tuple[int, int, int], size: int) -> None:
        for u, v in uv:
            cv2.circle(canvas, (round(float(u)), round(float(v))), size, colour, -1, cv2.LINE_AA)

    def line(canvas: Any, uv: Float, colour: tuple[int, int, int], closed: bool) -> None:
        cv2.polylines(canvas, [np.rint(uv).astype(np.int32)], closed, colour, 2, cv2.LINE_AA)

    for canvas, place in ((left, seen), (right, along)):
        dots(canvas, place(patch.xyz), (40, 140, 255), 1)
        line(canvas, place(se3.apply(pair.lidar_from_board, board.target.outline)), (255, 160, 0), True)
        dots(canvas, place(patch.ends), (230, 30, 30), 4)
        if isinstance(patch, HoleBoardInSweep):
            dots(canvas, place(patch.rim), (230, 30, 30), 4)
            for u, v, radius in patch.target.holes:
                turn = np.linspace(0, 2 * np.pi, 60)
                rim = np.stack([u + radius * np.cos(turn), v + radius * np.sin(turn), np.zeros(60)], axis=1)
                line(canvas, place(se3.apply(pair.lidar_from_board, rim)), (255, 160, 0), True)
    if isinstance(board.target, Checkerboard):
        found = camera.project(se3.apply(board.camera_from_board, board.target.corners))
    else:
        found = board.uv
    dots(
        left, found @ shrunk[:, :2].T + shrunk[:, 2], (60, 255, 60), 4 if isinstance(board.target, Checkerboard) else 2
    )
    for axis, colour in enumerate(((255, 60, 60), (60, 255, 60), (110, 110, 255))):
        tip = 0.3 * np.eye(3)[axis] * (-1 if axis == 2 else 1)
        ends = camera.project(se3.apply(board.camera_from_board, np.stack([np.zeros(3), tip])))
        line(left, ends @ shrunk[:, :2].T + shrunk[:, 2], colour, False)
    both = np.concatenate([left, right], axis=1)
    cv2.imwrite(str(path), both[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", nargs="*", help="names of rigs (default: all)")
    parser.add_argument("--real", type=Path, default=Path("build/data/rigs"), help="folder of the real rigs")
    parser.add_argument("--kept", type=Path, default=Path("build/boards-kept"), help="folder of what was found")
    parser.add_argument("--only", choices=("boards", "targetless"), help="leave the other rows out")
    parser.add_argument(
        "--methods", nargs="*", default=[m for each in METHODS.values() for m in each], help="their names"
    )
    parser.add_argument("--few", action="store_true", help="targetless p2o on the first five frames alone")
    parser.add_argument("--draw", type=Path, help="draw a frame of the first rig into this file instead")
    parser.add_argument("--frame", type=int, default=0, help="which frame is drawn")
    arguments = parser.parse_args()
    known = rigs(arguments.real)
    chosen = {name: known[name] for name in arguments.rig or known}
    if arguments.draw is not None:
        draw(next(iter(chosen.values())), arguments.draw, arguments.frame)
        return
    print(
        "| rig | method | poses | refused | deg, mean / median | cm, mean / median | coverage (67 %) | mean by axis |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name, rig in chosen.items():
        if arguments.only != "targetless":
            boards(name, rig, arguments.kept, arguments.methods)
        if arguments.only != "boards":
            targetless(name, rig, arguments.kept, arguments.few)


if __name__ == "__main__":
    main()
