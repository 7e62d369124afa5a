"""How far apart calibrations of one rig by different frames are, and from the published one: needs no truth.

    python benchmarks/repeatability.py --data kitti-raw:build/data/kitti_raw \
        --group kitti=@benchmarks/splits.json#test --group synthetic=@benchmarks/splits.json#train

Each group is calibrated jointly, from a start that is wrong by 2 deg and 15 cm, with the weights of P2ORNet that stand
before its frames. What two groups without a common drive have in common is not noise: it is a bias of the method, or
the error of what is published.
"""

from __future__ import annotations

import argparse
from itertools import combinations

import numpy as np
from p2o.frames.selection import select
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import PoseError, pose_error
from p2o.host.registry import Registry
from p2o.run.recipe import Recipe
from p2o.run.words import parse_settings


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="DATASET:PATH as for p2o run")
    parser.add_argument(
        "--group", action="append", required=True, metavar="WEIGHTS=FRAMES", help="frames as for p2o run"
    )
    parser.add_argument("--set", action="append", default=[], metavar="STAGE.FIELD=VALUE", help="an option")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    registry = Registry.load()
    poses, published = {}, None
    for text in arguments.group:
        weights, _, frames = text.partition("=")
        settings = parse_settings([*arguments.set, f"extractor.weights={weights}"])
        plan = Recipe.of(data=arguments.data, frames=frames, joint=True, options=settings).resolve(registry)
        dataset, pipeline = plan.dataset(), plan.calibrator()
        loaded = [dataset[index] for index in select(dataset.names, frames)]
        published = loaded[0].camera_from_lidar
        start = wrong_start(published, 2.0, 0.15, np.random.default_rng(arguments.seed))
        result = pipeline(loaded, start)
        name = f"{frames.rpartition('#')[2]}, {len(loaded)} frames, `{weights}`"
        poses[name] = result.camera_from_lidar
        stated = result.accuracy
        if stated is not None:
            print(
                f"{name}: likely within {stated.rotation_deg:.3f} deg and {100 * stated.translation_m:.1f} cm",
                flush=True,
            )
    poses["published"] = published
    print("\n| | | rotation deg | cm | right, down, forward cm |\n|---|---|---|---|---|")
    for first, second in combinations(poses, 2):
        print(f"| {first} | {second} | {row(pose_error(poses[first], poses[second]))} |")


def row(error: PoseError) -> str:
    """Return the columns of a difference of two poses."""
    axes = ", ".join(f"{100 * error.per_axis[axis]:+.1f}" for axis in ("x_m", "y_m", "z_m"))
    return f"{error.rotation_deg:.3f} | {100 * error.translation_m:.1f} | {axes}"


if __name__ == "__main__":
    main()
