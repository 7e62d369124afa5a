"""What share of the neighbours of right and of wrong poses cost more, by `idt`: the likelihoods of its test.

    python benchmarks/idt_likelihoods.py --data "synthetic:?scenes=24&place=street&seed=500"

Prints mean and standard deviation over single frames, at the truth and at poses that are wrong by --wrong in random
directions, and how often the test is right on frames that it was not learnt from (the second half).
"""

from __future__ import annotations

import argparse

import numpy as np
import p2o
from p2o.geometry.perturb import parse_perturbation
from p2o.run.recipe import open_dataset
from p2o_baselines.edges import idt, ring_discontinuity


def main() -> None:
    """Print the two Gaussians."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", default="synthetic:?scenes=24&place=street&seed=500")
    parser.add_argument("--wrong", default="1deg 0.1m")
    said = parser.parse_args()
    wrong, rng = parse_perturbation(said.wrong), np.random.default_rng(0)
    image, cloud = (
        idt.IMAGE.build(idt.IMAGE.options()),
        ring_discontinuity.METHOD.build(ring_discontinuity.METHOD.options()),
    )
    match, shares = idt.build(idt.METHOD.options()), []
    for frame in open_dataset(said.data, p2o.Registry.load()):
        view = p2o.View(frame.name, frame.camera, image(frame.image), cloud(frame.cloud))
        truth = frame.camera_from_lidar
        turn, shift = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        off = p2o.se3.exp(np.concatenate([np.radians(wrong.angle_deg) * turn, wrong.distance_m * shift])) @ truth
        shares.append([idt.share_of_worse(match([view], pose, 5.0), pose) for pose in (truth, off)])
    told = np.array(shares)
    for name, column in zip(("right", "wrong"), told.T, strict=True):
        print(f"{name}: mean {column.mean():.3f}, deviation {column.std(ddof=1):.3f}, {np.sort(column).round(2)}")
    half = len(told) // 2
    right, bad = (idt.Likelihood(c.mean(), max(c.std(ddof=1), 0.01)) for c in told[:half].T)
    log_odds = right.log(told[half:]) - bad.log(told[half:])
    for count in (1, 3, 9):
        groups = [log_odds[i : i + count].sum(axis=0) > 0 for i in range(len(log_odds) - count + 1)]
        if groups:
            kept, refused = np.mean(groups, axis=0)
            print(f"{count} frames: {100 * kept:.0f} % of right poses pass, {100 * refused:.0f} % of wrong ones")


if __name__ == "__main__":
    main()
