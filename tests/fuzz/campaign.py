"""Many cases, each drawn from its own number: any one can be drawn again."""

from __future__ import annotations

import multiprocessing
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Any

from tests.fuzz import sandbox
from tests.fuzz.bases import Bases
from tests.fuzz.contract import broken
from tests.fuzz.doors import SURFACES, draw


@dataclass(frozen=True)
class Verdict:
    """How one case ended: `broken` names the promises that were not kept; `kept` is where its files lie then."""

    number: int
    door: str
    argv: tuple[str, ...]
    status: int | None
    cpu_s: float
    peak_bytes: int
    broken: tuple[str, ...]
    kept: Path | None = None

    @property
    def sort(self) -> str:
        """What its fault is like, with all that is different from case to case left out."""
        text = self.broken[0] if self.broken else ""
        return f"{self.door}: " + re.sub(r"'[^']*'|\"[^\"]*\"|\d+(\.\d+)?|/\S+", "*", text)[:120]


@dataclass
class Tally:
    """What a campaign found."""

    verdicts: list[Verdict] = field(default_factory=list)

    @property
    def bad(self) -> list[Verdict]:
        """The cases that broke a promise, in order of their numbers."""
        return sorted((v for v in self.verdicts if v.broken), key=lambda v: v.number)

    def __str__(self) -> str:
        lines = []
        for door in (*SURFACES, "none"):
            here = [v for v in self.verdicts if v.door == door]
            if here:
                ends = Counter("hung or killed" if v.status is None else str(v.status) for v in here)
                ended = ", ".join(f"{count} x {status}" for status, count in sorted(ends.items()))
                peak, long = max(v.peak_bytes for v in here) / 1e6, max(v.cpu_s for v in here)
                wrong = sum(bool(v.broken) for v in here)
                lines.append(
                    f"{door:<11} {len(here):>6} cases, ended {ended}; to {peak:.0f} MB, {long:.1f} s; {wrong} broken"
                )
        sorts: dict[str, list[Verdict]] = {}
        for verdict in self.bad:
            sorts.setdefault(verdict.sort, []).append(verdict)
        for alike in sorted(sorts.values(), key=len, reverse=True):
            first = alike[0]
            lines.append(f"{len(alike)} x {first.door}: {first.broken[0]}  [case {first.number}: {first.kept}]")
        lines.append(f"{len(self.verdicts)} cases, {len(self.bad)} broken")
        return "\n".join(lines)


def one(bases: Bases, home: Path, seed: int, number: int, doors: Sequence[str], *, keep: bool = False) -> Verdict:
    """Draw a case, run it in the folder `home`, and judge it; the folder stays where a promise was broken."""
    shutil.rmtree(home, ignore_errors=True)
    home.mkdir(parents=True)
    try:
        door, case = draw(Random(f"{seed} {number}"), bases, home, doors)
    except Exception as problem:  # a fault of ours: the campaign tells it and goes on
        return Verdict(number, "none", (), None, 0.0, 0, (f"cannot be drawn: {problem!r}",), home)
    outcome = sandbox.run(case, home, case.hangs)
    found = tuple(broken(case, outcome, home))
    if not found and not keep:
        shutil.rmtree(home)
    if found:
        words = "\n".join([" ".join(case.argv), *found])
        (home / "broken.txt").write_text(words + "\n", encoding="utf-8", errors="backslashreplace")
    return Verdict(
        number,
        door,
        case.argv,
        outcome.status,
        outcome.cpu_s,
        outcome.peak_bytes,
        found,
        home if found or keep else None,
    )


def campaign(bases: Bases, root: Path, *, cases: int, seed: int, jobs: int, doors: Sequence[str]) -> Iterator[Verdict]:
    """Yield the verdict of each case as it ends; `jobs` processes share them."""
    numbers = range(cases)
    if jobs == 1:
        yield from (one(bases, root / f"case-{number}", seed, number, doors) for number in numbers)
        return
    # Forks of this process, which has everything loaded; their cases may have processes of their own.
    fork: Any = multiprocessing.get_context("fork")
    tasks = ((bases, root / f"case-{number}", seed, number, doors) for number in numbers)
    with ProcessPoolExecutor(jobs, fork) as pool:
        yield from pool.map(_one, tasks, chunksize=8)


def _one(task: Any) -> Verdict:
    return one(*task)
