"""Count trusted results that are local minima, with and without the comparison with poses near each result.

    python benchmarks/local_minima.py --data kitti-raw:build/data/kitti_raw [--split train] [--every 4] [--guesses 2]

Every n-th frame of a split of benchmarks/splits.json, one frame at a time, several initial guesses: with Algorithm 1
alone (`given`), and with the search from initial errors within and beyond its range. Printed are trusted results, of
these wrong ones (over 1 deg or 30 cm), good results (below 0.5 deg and 15 cm), and of these trusted ones.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from pathlib import Path
from unittest.mock import patch

from p2o import Frame, Registry
from p2o.calibration.algorithm import Algorithm, Refined
from p2o.run.outcome import Row
from p2o.run.recipe import Recipe
from p2o.run.run import run

WRONG, GOOD = (1.0, 0.3), (0.5, 0.15)
CASES = (("given", "2deg 0.15m"), ("search", "2deg 0.15m"), ("search", "4deg 0.3m"), ("search", "8deg 0.6m"))
SPLITS = Path(__file__).with_name("splits.json")


def counts(rows: Sequence[Row]) -> str:
    """Return the counts of a case as cells of a table."""
    trusted = wrong = good = good_trusted = 0
    for row in rows:
        assert row.error is not None
        turn, shift, sure = row.error.rotation_deg, row.error.translation_m, row.result.verdict.trusted
        is_good = turn < GOOD[0] and shift < GOOD[1]
        trusted, good = trusted + sure, good + is_good
        wrong += sure and (turn > WRONG[0] or shift > WRONG[1])
        good_trusted += sure and is_good
    return f"{trusted}, {wrong} | {good}, {good_trusted}"


def results(data: str, frames: Sequence[Frame], init: str, perturb: str, guesses: int, registry: Registry) -> list[Row]:
    """Return the results of all frames from all initial guesses."""
    words = {"data": data, "init": init, "perturb": perturb}
    plans = [Recipe.of(**words, seed=seed).resolve(registry) for seed in range(guesses)]
    return [row for plan in plans for row in run(plan, frames).rows]


def unchanged(algorithm: Algorithm, refined: Refined) -> Refined:
    """Return the refined poses without rivals."""
    return refined


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True)
    parser.add_argument("--split", default="train")
    parser.add_argument("--every", type=int, default=4)
    parser.add_argument("--guesses", type=int, default=2)
    asked = parser.parse_args()
    registry = Registry.load()
    dataset = Recipe.of(data=asked.data).resolve(registry).dataset()
    chosen = json.loads(SPLITS.read_text(encoding="utf-8"))[asked.split][:: asked.every]
    frames = [dataset[list(dataset.names).index(name)] for name in chosen]
    print("| init, error | n | without: trusted, wrong | good, trusted | with: trusted, wrong | good, trusted |")
    print("|---|---|---|---|---|---|")
    for init, perturb in CASES:
        words = asked.data, frames, init, perturb, asked.guesses, registry
        with patch.object(Algorithm, "with_rivals", unchanged):
            before = results(*words)
        after = counts(results(*words))
        print(f"| {init}, {perturb} | {len(before)} | {counts(before)} | {after} |", flush=True)


if __name__ == "__main__":
    main()
