"""Does the agreement tell right pairs of image and sweep from wrong ones?

    python benchmarks/wrong_pairs.py --data kitti-raw:build/data/kitti_raw --frames @benchmarks/splits.json#test

Every frame is calibrated from 2 deg / 0.15 m, then again with the sweep of another frame (the one seven further on).
Prints how many of each are called doubtful or refused, how many ambiguous as well, and the errors of the right pairs
that are and are not.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
from p2o.frames.selection import select
from p2o.geometry.perturb import wrong_start
from p2o.geometry.pose_error import pose_error
from p2o.host.registry import Registry
from p2o.results.verdict import Trust
from p2o.run.recipe import Recipe


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="DATASET:PATH as for p2o run")
    parser.add_argument("--frames", default="all", help="as for p2o run")
    parser.add_argument("--extractor", default="stereo/rings", help="as for p2o run")
    arguments = parser.parse_args()
    plan = Recipe.of(data=arguments.data, frames=arguments.frames, extractor=arguments.extractor).resolve(
        Registry.load()
    )
    dataset, pipeline = plan.dataset(), plan.calibrator()
    frames = [dataset[index] for index in select(dataset.names, arguments.frames)]
    views = [pipeline.prepare(frame) for frame in frames]
    print(
        "| pair | flagged (doubtful or refused) | or ambiguous | odds ratio, median | error of flagged "
        "| error of others (medians) | predicted error, median | required 0.5 deg 15 cm |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for kind, shift in (("right", 0), ("wrong", 7)):
        odds, flags, errors, likely, any_flag, passed = [], [], [], [], 0, 0
        for number, (view, frame) in enumerate(zip(views, frames, strict=True)):
            other = views[(number + shift) % len(views)]
            start = wrong_start(frame.camera_from_lidar, 2.0, 0.15, np.random.default_rng([0, number]))
            result = pipeline.solve([replace(view, cloud=other.cloud)], start)
            odds.append(np.nan if result.agreement is None else result.agreement.odds_ratio)
            flags.append(result.verdict.trust in (Trust.DOUBTFUL, Trust.REFUSED))
            any_flag += not result.verdict.trusted
            passed += result.reaches(0.5, 0.15)
            if result.accuracy is not None:
                likely.append((result.accuracy.rotation_deg, result.accuracy.translation_m))
            errors.append(pose_error(result.camera_from_lidar, frame.camera_from_lidar))
        cells = []
        for wanted in (True, False):
            picked = [e for e, flag in zip(errors, flags, strict=True) if flag == wanted]
            turn, shift_m = (
                np.median([getattr(e, a) for e in picked] or [0]) for a in ("rotation_deg", "translation_m")
            )
            cells.append(f"{turn:.2f} deg {100 * shift_m:.0f} cm" if picked else "none")
        turn, shift_m = np.median(likely, axis=0) if likely else (np.nan, np.nan)
        print(
            f"| {kind} | {sum(flags)} of {len(flags)} | {any_flag} | {np.nanmedian(odds):.1f} "
            f"| {cells[0]} | {cells[1]} | {turn:.2f} deg {100 * shift_m:.0f} cm "
            f"| {passed} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
