"""Equivalences of versions of a method: a change of its code that altered no outcome of a random sample of rows."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable
from typing import Annotated

from pydantic import Field, model_validator

from p2o_study.benchmark.row import Digest, JsonLine, Machine, Timestamp
from p2o_study.study import Label, Line, Seed, Slug

EQUIVALENCES_FILE = "equivalences.jsonl"
_Count = Annotated[int, Field(ge=1, le=2_000_000)]


class Equivalence(JsonLine):
    """A sample of rows of one method, computed again with a later version of it, with the same outcomes.

    `digests` maps the digest of each earlier version to that of the later one: options with a seed give a digest for
    each seed. Of the `of` rows with these digests on `places` (suite and dataset), a random sample of `confirmed` rows,
    drawn with `seed`, was computed again. `commit`, `versions` and `machine` are those of this computation.
    """

    label: Label
    digests: dict[Digest, Digest] = Field(min_length=1, max_length=100_000)
    places: tuple[tuple[Slug, Slug], ...] = Field(min_length=1, max_length=10_000)
    confirmed: _Count
    of: _Count
    seed: Seed
    commit: Line
    versions: dict[Line, Line] = Field(default_factory=dict, max_length=200)
    machine: Machine
    measured_by: Line
    finished: Timestamp

    @model_validator(mode="after")
    def _consistent(self) -> Equivalence:
        if self.confirmed > self.of:
            raise ValueError("at most `of` confirmed rows")
        if any(old == new for old, new in self.digests.items()):
            raise ValueError("two different digests")
        return self


class Equivalences:
    """Equivalences by the digest of the earlier version."""

    def __init__(self, equivalences: Iterable[Equivalence] = ()) -> None:
        self._by_digest: dict[str, list[Equivalence]] = {}
        for equivalence in equivalences:
            for old in equivalence.digests:
                self._by_digest.setdefault(old, []).append(equivalence)

    def sample(self, old: str, new: str, suite: str, dataset: str) -> int | None:
        """Return the number of confirmed rows if equivalences on this suite and dataset lead from `old` to `new`.

        In a chain, the smallest number counts. 0 for equal digests, None where no chain leads to `new`.
        """
        samples = {old: 0}
        waiting = deque([old])
        while waiting and new not in samples:
            digest = waiting.popleft()
            for link in self._by_digest.get(digest, ()):
                later = link.digests[digest]
                if later not in samples and (suite, dataset) in link.places:
                    samples[later] = min(samples[digest] or link.confirmed, link.confirmed)
                    waiting.append(later)
        return samples.get(new)

    def reachable(self, digests: Collection[str], suite: str) -> list[Equivalence]:
        """Return the equivalences on a suite that begin at these digests, directly or by a chain."""
        chosen: dict[str, Equivalence] = {}
        waiting, reached = list(digests), set(digests)
        while waiting:
            for link in self._by_digest.get(digest := waiting.pop(), ()):
                if any(place[0] == suite for place in link.places):
                    chosen[link.line] = link
                    if (later := link.digests[digest]) not in reached:
                        reached.add(later)
                        waiting.append(later)
        return list(chosen.values())


NONE = Equivalences()
"""No equivalences: only equal digests are the same version."""
