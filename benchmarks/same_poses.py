"""Compare the results of two stores of a study row by row: a change of structure must not change any of them.

    p2o ablate smoke --out A          at one commit
    p2o ablate smoke --out B          at another one
    python benchmarks/same_poses.py A B [--columns estimate status trust]

Rows are identified by study, label, dataset, frames, number of joint frames and seed. Values are compared as they are
stored, so poses are the same to the last digit. Exit status 0: the stores agree, 1: they differ, 2: a store is missing.
"""

from __future__ import annotations

import argparse
import json
import sqlite3
import sys
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

KEY = ("study", "row", "dataset", "frames", "joint", "seed")
COLUMNS = ("estimate", "status", "trust")


def stored(folder: Path, columns: Sequence[str]) -> dict[tuple[Any, ...], tuple[Any, ...]]:
    """Return the values of `columns` of every finished row by its key; works for stores of any version.

    Raises FileNotFoundError where the folder has no store, ValueError where two rows have the same key.
    """
    path = folder / "study.sqlite"
    if not path.is_file():
        raise FileNotFoundError(f"no store: {path}; expected the --out folder of p2o ablate")
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as connection:
        rows = connection.execute(f"SELECT {', '.join((*KEY, *columns))} FROM rows").fetchall()
    values = {row[: len(KEY)]: row[len(KEY) :] for row in rows}
    if len(values) < len(rows):
        raise ValueError(f"{path} has {len(rows) - len(values)} rows with the key of another one: compare one study")
    return values


def difference(one: str, other: str) -> str:
    """Return the largest difference of two stored poses, for the report."""
    poses = [np.asarray(json.loads(text), dtype=np.float64) if text else None for text in (one, other)]
    if poses[0] is None or poses[1] is None:
        return "one has no pose"
    return f"differ by at most {np.abs(poses[0] - poses[1]).max():.1e}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print every row that differs, and the numbers of rows that agree, differ and exist in one store only."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--columns", nargs="+", default=list(COLUMNS), metavar="COLUMN", help="columns to compare")
    options = parser.parse_args(arguments)
    try:
        before, after = (stored(folder, options.columns) for folder in (options.before, options.after))
    except (FileNotFoundError, ValueError, sqlite3.Error) as problem:
        print(problem, file=sys.stderr)
        return 2
    different = 0
    for key in sorted(before.keys() & after.keys(), key=str):
        changed = [
            f"{column}: {difference(a, b) if column == 'estimate' else f'{a} -> {b}'}"
            for column, a, b in zip(options.columns, before[key], after[key], strict=True)
            if a != b
        ]
        if changed:
            different += 1
            print(" ".join(str(part) for part in key), "; ".join(changed), sep=": ")
    alone = len(before.keys() ^ after.keys())
    print(
        f"{len(before.keys() & after.keys()) - different} rows are equal, {different} differ, {alone} are in one store"
    )
    return int(different + alone > 0)


if __name__ == "__main__":
    sys.exit(main())
