"""Whether results told the truth about themselves: likely errors that held, and trusted results that are wrong."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from p2o.geometry.perturb import Perturbation
from p2o.results.verdict import Trust
from p2o.study.store import StoredRow

WRONG = Perturbation(angle_deg=1.0, distance_m=0.3)
"""A result that is farther from the truth, in rotation or in translation, should not be called trusted."""
WRONG_TOLD = f"over {WRONG.angle_deg:g} deg or {100 * WRONG.distance_m:g} cm off"


@dataclass(frozen=True)
class Held:
    """Of `count` results that say how wrong they may be, and whose error is known, so many were no worse than that.

    `rotation` and `translation` count those within the bound that two of three should keep, `rotation_95` and
    `translation_95` those within the one that nineteen of twenty should.
    """

    count: int
    rotation: int
    translation: int
    rotation_95: int
    translation_95: int

    @property
    def two_thirds(self) -> str:
        """Rotations and translations within the bound for two of three, such as "13/20 12/20"; "-" for no result."""
        return self._shares(self.rotation, self.translation)

    @property
    def nineteen_twentieths(self) -> str:
        """Rotations and translations within the bound for nineteen of twenty."""
        return self._shares(self.rotation_95, self.translation_95)

    def _shares(self, *held: int) -> str:
        return " ".join(f"{number}/{self.count}" for number in held) if self.count else "-"


NONE = Held(0, 0, 0, 0, 0)


def held(rows: Iterable[StoredRow], before: Held = NONE) -> Held:
    """Return how many of the results kept what they promised; those without a likely error, or a truth, are left out.

    A likely error that is infinite promises nothing, and holds. Those counted `before` are counted, too.
    """
    counts = [before.count, before.rotation, before.translation, before.rotation_95, before.translation_95]
    for row in rows:
        pairs = (
            (row.rotation_deg, row.likely_rotation_deg),
            (row.translation_m, row.likely_translation_m),
            (row.rotation_deg, row.likely_rotation_deg_95),
            (row.translation_m, row.likely_translation_m_95),
        )
        known = [error <= bound for error, bound in pairs if error is not None and bound is not None]
        if row.solved and len(known) == len(pairs):
            counts = [count + kept for count, kept in zip(counts, (True, *known), strict=True)]
    return Held(*counts)


def trusted_wrong(rows: Iterable[StoredRow]) -> int:
    """Return how many results were called trusted and are farther from the truth than `WRONG`."""
    return sum(row.trust is Trust.TRUSTED and wrong(row) for row in rows)


def pooled(rows: Iterable[StoredRow]) -> list[str]:
    """Return lines that tell of all rows together whether likely errors held and trust was deserved; none for none."""
    kept, lines, trusted, far_off = NONE, [], 0, 0
    for row in rows:
        kept = held([row], kept)
        trusted += row.trust is Trust.TRUSTED
        far_off += trusted_wrong([row])
    if kept.count:
        shares = [
            f"{_share(turned, kept.count)} of rotations and {_share(moved, kept.count)} of translations ({name})"
            for turned, moved, name in (
                (kept.rotation, kept.translation, "two of three promised"),
                (kept.rotation_95, kept.translation_95, "19 of 20 promised"),
            )
        ]
        lines.append(f"Likely errors of {kept.count} runs held for {', '.join(shares)}")
    if trusted:
        lines.append(f"Trusted: {trusted} runs, {far_off} of them {WRONG_TOLD}")
    return lines


def _share(number: int, count: int) -> str:
    return f"{100 * number / count:.0f} %"


def wrong(row: StoredRow) -> bool:
    """Return whether a result is known to be farther from the truth than `WRONG`."""
    sizes = (row.rotation_deg, WRONG.angle_deg), (row.translation_m, WRONG.distance_m)
    return any(error is not None and error > bound for error, bound in sizes)
