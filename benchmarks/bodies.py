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
from p2o import Calibrator, Frame, Method, Registry
from p2o.arrays import Float
from p2o.run.recipe import Recipe
from p2o.work.cache import FeatureCache, content_hash
from p2o_baselines import gong, kuemmerle, pusztai

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
    pictures, sweeps = sum(bool(s.pictures) for s in found), sum(bool(s.sweeps) for s in found)
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rig", nargs="*", choices=RIGS, help="names of rigs (default: all)")
    parser.add_argument("--kept", type=Path, default=Path("build/bodies-kept"), help="folder of what was found")
    parser.add_argument("--only", choices=("bodies", "targetless"), help="leave the other rows out")
    arguments = parser.parse_args()
    print(
        "| rig | method | poses | refused | deg, mean / median | cm, mean / median | likely error held | mean by axis |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for rig in arguments.rig or RIGS:
        if arguments.only != "targetless":
            bodies(rig, arguments.kept)
        if arguments.only != "bodies":
            targetless(rig)


if __name__ == "__main__":
    main()
