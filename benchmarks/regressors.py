"""Measure learned regressors on frames of their rig and of others, and draw their stages at work.

    python benchmarks/regressors.py                                        # every figure of the page, into p2o-out
    python benchmarks/regressors.py --methods lccnet,p2o --conditions raw,turned
    python benchmarks/regressors.py --gallery docs/gallery                 # the image, of a synthetic frame

Figures of docs/comparison-learned.md: one line of JSON a result in OUT/results.jsonl, which is gone on with where it is
there, and tables from all of them.

Conditions: `raw` 24 test frames of KITTI raw; `odometry` 13 frames of odometry 00 that no training saw; then the same
test frames of raw with another LiDAR frame (`reexpressed`), the camera turned on its place (`turned`: image and
truth), cut to their middle (`cut`), with a grey image (`grey`)
and with the image of another frame (`swapped`); `waymo`, `nuscenes`, and rigs simulated at random (`simulated`).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import se3
from p2o.arrays import Float

METHODS = ("regnet", "calibnet", "rggnet", "calibrcnn", "lccnet")
PROTOCOLS = ("calibdepth", "projfusion-15-15", "lccnet-20")
FIRST = {"calibdepth": 2, "projfusion-15-15": 2, "lccnet-20": 1}
"""Stage that methods of five stages begin with: the nearest about as wide as the starts; others use all of theirs."""
FIVE_STAGES = ("regnet", "lccnet")
TURN_DEG, CUT = 3.0, 0.7
ODOMETRY_SEEN = 12
"""Frames of odometry 00, from the first, that the shipped weights have seen."""
SIMULATED = "synthetic:?rig=random&place=street&scenes=12&seed=271&right=false&megapixels=0.5"


def test_frames(folder: Path) -> list[p2o.Frame]:
    """Return the test frames of KITTI raw, motion-compensated if the speed is known."""
    split = json.loads(Path(__file__).with_name("splits.json").read_text())["test"]
    data = frames_of(f"kitti-raw:{folder}/kitti_raw?speed_from_disparity=true")
    return [frame for frame in data if frame.name in split]


def frames_of(data: str) -> Iterator[p2o.Frame]:
    """Yield all frames of a dataset."""
    yield from p2o.Recipe.of(data=data).resolve(p2o.Registry.load()).dataset()


def reexpressed(frame: p2o.Frame, rng: np.random.Generator) -> p2o.Frame:
    """Return the frame with its sweep in another LiDAR frame, randomly rotated and translated, and the truth."""
    turn, shift = rng.normal(size=(2, 3))
    other = se3.exp(np.r_[turn, shift])
    cloud = replace(frame.cloud, xyz=se3.apply(other, frame.cloud.xyz), twist=None)
    return replace(frame, cloud=cloud, camera_from_lidar=frame.camera_from_lidar @ se3.inverse(other))


def turned(frame: p2o.Frame, rng: np.random.Generator) -> p2o.Frame:
    """Return the frame as a camera sees it that is turned on its place by up to 3 deg about each axis.

    A turn on the place changes an image by a homography, exactly; what comes into view is black, and masked.
    """
    import cv2

    fx, fy, cx, cy = frame.camera.params
    turn = se3.exp(np.r_[np.radians(rng.uniform(-TURN_DEG, TURN_DEG, 3)), 0, 0, 0])[:3, :3]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    warp = matrix @ turn @ np.linalg.inv(matrix)
    size = frame.image.rgb.shape[1::-1]
    rgb = np.asarray(cv2.warpPerspective(frame.image.rgb, warp, size), np.uint8)
    known = np.asarray(cv2.warpPerspective(np.ones(size[::-1], np.uint8), warp, size, flags=cv2.INTER_NEAREST))
    image = p2o.Image(rgb, frame.camera, masked=known == 0)
    return replace(frame, image=image, camera_from_lidar=se3.make(turn, np.zeros(3)) @ frame.camera_from_lidar)


def cut(frame: p2o.Frame, zoom: float = 1 / CUT) -> p2o.Frame:
    """Return the frame cut to its middle, with the intrinsics of the cut."""
    camera = frame.camera
    width, height = round(camera.width / zoom), round(camera.height / zoom)
    left, top = (camera.width - width) // 2, (camera.height - height) // 2
    fx, fy, cx, cy = camera.params
    rgb = np.ascontiguousarray(frame.image.rgb[top : top + height, left : left + width])
    return replace(frame, image=p2o.Image(rgb, p2o.Camera.pinhole(fx, fy, cx - left, cy - top, width, height)))


def with_picture(frame: p2o.Frame, rgb: Any) -> p2o.Frame:
    """Return the frame with another image of the same size."""
    height, width = frame.image.rgb.shape[:2]
    out = np.full((height, width, 3), 118, np.uint8)
    if rgb is not None:
        out[: min(height, len(rgb)), : min(width, rgb.shape[1])] = rgb[:height, :width]
    return replace(frame, image=p2o.Image(out, frame.camera))


def conditions(folder: Path) -> Mapping[str, Callable[[], list[p2o.Frame]]]:
    """Return the frames of each condition, made when they are asked for."""
    raw: list[p2o.Frame] = []

    def test() -> list[p2o.Frame]:
        if not raw:
            raw.extend(test_frames(folder))
        return raw

    def changed(how: Callable[[p2o.Frame, np.random.Generator], p2o.Frame]) -> Callable[[], list[p2o.Frame]]:
        return lambda: [how(frame, np.random.default_rng([9, i])) for i, frame in enumerate(test())]

    return {
        "raw": test,
        "odometry": lambda: list(frames_of(f"kitti-odometry:{folder}/kitti_odometry"))[ODOMETRY_SEEN:],
        "reexpressed": changed(reexpressed),
        "turned": changed(turned),
        "cut": changed(lambda frame, rng: cut(frame)),
        "grey": changed(lambda frame, rng: with_picture(frame, None)),
        "swapped": lambda: [with_picture(f, test()[(i + 7) % len(test())].image.rgb) for i, f in enumerate(test())],
        "waymo": lambda: list(frames_of(f"folder:{folder}/rigs/waymo")),
        "nuscenes": lambda: list(frames_of(f"folder:{folder}/rigs/nuscenes")),
        "simulated": lambda: list(frames_of(SIMULATED)),
    }


def measured(
    method: str, frames: Sequence[p2o.Frame], protocol: str, weights: Path | None, joint: int = 1
) -> Iterator[dict[str, Any]]:
    """Yield a record of each calibration: errors of start and result by camera axis."""
    if method == "p2o":
        words: dict[str, Any] = {"init": "far"}
        if protocol != "lccnet-20":
            words["options"] = {"init": {"reach_deg": 15.0, "reach_m": 0.3}}
    else:
        said: dict[str, Any] = {"first": FIRST[protocol] if method in FIVE_STAGES else 1}
        if weights is not None:
            said["weights"] = str(weights / f"{method}-small.safetensors")
        words = {"calibrator": method, "witness": "none", "options": {"calibrator": said}}
    groups = [frames[i : i + joint] for i in range(0, len(frames), joint)]
    for number, group in enumerate(groups):
        run = p2o.calibrate(list(group), protocol=protocol, seed=number, joint=joint > 1, **words)
        for row in run.rows:
            result = row.result
            off = [axes(pose, row.truth) for pose in (result.start, result.camera_from_lidar)]
            yield {
                "frame": group[0].name,
                "status": str(result.status),
                "trusted": bool(result.verdict.trusted),
                "start": off[0],
                "end": off[1],
                "seconds": float(sum(result.seconds.values())),
            }
        for failed in run.failed:
            yield {"frame": failed.frame, "status": failed.reason, "trusted": False, "start": None, "end": None}


def axes(pose: Float, truth: Float) -> list[float]:
    """Return the error of a pose: rotation vector of pose truth^-1 in deg, shift of the LiDAR in m, in the camera."""
    off = pose @ se3.inverse(truth)
    return [*np.degrees(se3.rotation_vector(off[:3, :3])).tolist(), *(pose[:3, 3] - truth[:3, 3]).tolist()]


@dataclass(frozen=True)
class Tally:
    """Errors of one method in one condition: start and end (N, 6) as `axes` gives them."""

    start: Float
    end: Float

    @classmethod
    def of(cls, records: Sequence[dict[str, Any]]) -> Tally:
        """Return the errors of records; a frame without a result counts with nothing."""
        rows = [record for record in records if record["start"]]
        return cls(*(np.array([row[name] for row in rows]).reshape(-1, 6) for name in ("start", "end")))

    @staticmethod
    def sizes(errors: Float) -> tuple[Float, Float]:
        """Return angles (N,) in deg and lengths (N,) in cm."""
        return np.linalg.norm(errors[:, :3], axis=1), 100 * np.linalg.norm(errors[:, 3:], axis=1)

    @property
    def rotation(self) -> str:
        """Mean and median angle."""
        deg, _ = self.sizes(self.end)
        return f"{deg.mean():.2f} / {np.median(deg):.2f}"

    @property
    def translation(self) -> str:
        """Mean and median length."""
        _, cm = self.sizes(self.end)
        return f"{cm.mean():.1f} / {np.median(cm):.1f}"

    @property
    def left(self) -> str:
        """What is left of the start's pitch, yaw and roll, as shares of the means."""
        return " ".join(f"{x:.2f}" for x in (np.abs(self.end).mean(0) / np.abs(self.start).mean(0))[:3])


def table(records: Sequence[dict[str, Any]], protocol: str, joint: int) -> str:
    """Return tables of a protocol as Markdown: rotation, what is left by axis, translation; a column a method."""
    kept = [r for r in records if r["protocol"] == protocol and r["joint"] == joint]
    methods = [m for m in (*METHODS, "p2o") if any(r["method"] == m for r in kept)]
    tallies: dict[tuple[str, str], Tally] = {}
    for r in kept:
        same = (r["condition"], r["method"])
        if same not in tallies:
            tallies[same] = Tally.of([k for k in kept if (k["condition"], k["method"]) == same])
    lines = []
    for what in ("rotation", "left", "translation"):
        lines += [
            f"{what}",
            "",
            f"| condition | frames | start | {' | '.join(methods)} |",
            "|---" * (len(methods) + 3) + "|",
        ]
        for condition in dict.fromkeys(r["condition"] for r in kept):
            first = next(t for (c, _), t in tallies.items() if c == condition)
            deg, cm = first.sizes(first.start)
            start = {"rotation": f"{deg.mean():.2f}", "translation": f"{cm.mean():.1f}", "left": "1 1 1"}[what]
            cells = [getattr(tallies[condition, m], what) if (condition, m) in tallies else "" for m in methods]
            lines.append(f"| {condition} | {len(first.end)} | {start} | {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path("build/data"), help="folder with kitti_raw, rigs and so on")
    parser.add_argument("--out", type=Path, default=Path("p2o-out/regressors"), help="folder of the results")
    parser.add_argument("--methods", default=",".join((*METHODS, "p2o")), help="parted by commas; p2o is the default")
    parser.add_argument("--protocols", default=",".join(PROTOCOLS))
    parser.add_argument("--conditions", default="", help="parted by commas; all of them if left out")
    parser.add_argument("--weights", type=Path, help="folder of METHOD-small.safetensors, for those shipped")
    parser.add_argument("--joint", type=int, default=1, help="frames that are calibrated together")
    parser.add_argument("--gallery", type=Path, help="draw into this folder, measure nothing")
    said = parser.parse_args()
    if said.gallery:
        draw(said.gallery / "regressor.jpg", said.weights)
        return
    said.out.mkdir(parents=True, exist_ok=True)
    path = said.out / "results.jsonl"
    records = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    done = {(r["condition"], r["method"], r["protocol"], r["joint"]) for r in records}
    ways = conditions(said.data)
    for condition in said.conditions.split(",") if said.conditions else ways:
        frames: list[p2o.Frame] = []
        for method in said.methods.split(","):
            for protocol in said.protocols.split(","):
                key = {"condition": condition, "method": method, "protocol": protocol, "joint": said.joint}
                if tuple(key.values()) in done:
                    continue
                frames = frames or ways[condition]()
                found = [{**key, **each} for each in measured(method, frames, protocol, said.weights, said.joint)]
                records += found
                with path.open("a") as file:
                    file.writelines(json.dumps(each) + "\n" for each in found)
                print(*key.values(), f"{len(found)} results", flush=True)
    for protocol in said.protocols.split(","):
        print(f"\n{protocol}\n\n{table(records, protocol, said.joint)}")


def draw(path: Path, weights: Path | None) -> None:
    """Write the image of a synthetic frame: what a network sees at the start, after stages, and at the truth."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from p2o_baselines.learned.lccnet import DESIGN
    from p2o_baselines.regressors.method import built
    from p2o_baselines.regressors.options import RegressorOptions

    frame = next(frames_of("synthetic:?scenes=1&place=street&seed=5&right=false&exposure_ev=0"))
    options = RegressorOptions(weights=str(weights / "lccnet-small.safetensors") if weights else "small")
    method = built(DESIGN, options)
    network_input = method.prepare(frame)
    truth = frame.camera_from_lidar
    start = se3.exp(np.r_[np.radians([9.0, -7.0, 8.0]), 0.15, -0.1, 0.15]) @ truth
    poses = [each[0] for each in method.poses([network_input], start)]
    last = len(poses) - 1
    panels = [("at the start", poses[0]), (f"after 1 of {last} stages", poses[1]), (f"after all {last}", poses[last])]
    panels.append(("at the truth", truth))
    figure, rows = plt.subplots(len(panels), 2, figsize=(12.4, 2.0 * len(panels)), layout="constrained")
    for (name, pose), (left, right) in zip(panels, rows, strict=True):
        [near] = network_input.drawn(pose)
        left.imshow(np.where(near > 0, near, np.nan), cmap="turbo", vmin=0, vmax=1, interpolation="nearest")
        pitch, yaw, roll = axes(pose, truth)[:3]
        off = "" if pose is truth else f": off by pitch {pitch:.1f}, yaw {yaw:.1f}, roll {roll:.1f} deg"
        left.set_title(f"the sweep {name}{off}", fontsize=10)
        right.imshow(frame.image.rgb)
        there = se3.apply(pose, frame.cloud.xyz)
        uv = frame.camera.project(there)
        seen = frame.camera.in_image(uv)
        right.scatter(*uv[seen].T, c=np.log(there[seen, 2]), cmap="turbo_r", s=0.3)
        right.set_xlim(0, frame.camera.width)
        right.set_ylim(frame.camera.height, 0)
        for panel in (left, right):
            panel.set_axis_off()
    figure.savefig(path, dpi=90, pil_kwargs={"quality": 72})


if __name__ == "__main__":
    main()
