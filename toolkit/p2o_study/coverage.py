"""Coverage of predicted errors, and false accepts: trusted results with a large error."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from p2o.geometry.perturb import Perturbation
from p2o.results.verdict import Trust

from p2o_study.store import StoredRow

WRONG = Perturbation(angle_deg=1.0, distance_m=0.3)
"""A trusted result with a larger rotation or translation error is a false accept."""
WRONG_TEXT = f"with an error above {WRONG.angle_deg:g} deg or {100 * WRONG.distance_m:g} cm"


@dataclass(frozen=True)
class BoundCoverage:
    """The coverage of predicted errors over `count` results with a predicted and a known error.

    `rotation` and `translation` count errors within the 67 % bound, `rotation_95` and `translation_95` within the 95 %
    bound.
    """

    count: int
    rotation: int
    translation: int
    rotation_95: int
    translation_95: int

    @property
    def text_67(self) -> str:
        """Rotations and translations within the 67 % bound, such as "13/20 12/20"; "-" without results."""
        return self._shares(self.rotation, self.translation)

    @property
    def text_95(self) -> str:
        """Rotations and translations within the 95 % bound."""
        return self._shares(self.rotation_95, self.translation_95)

    def _shares(self, *counts: int) -> str:
        return " ".join(f"{number}/{self.count}" for number in counts) if self.count else "-"


NONE = BoundCoverage(0, 0, 0, 0, 0)


def predicted(row: StoredRow, name: str) -> float | None:
    """Return a predicted error of a row, such as "rotation_deg_95"; None where it is unknown."""
    value = row.figures.get(f"predicted_{name}")
    return None if value is None else float(value)


def bound_coverage(rows: Iterable[StoredRow], before: BoundCoverage = NONE) -> BoundCoverage:
    """Return the coverage of the predicted errors of results, added to `before`.

    Results without a predicted error or a ground truth are left out. An infinite predicted error covers every error.
    """
    counts = [before.count, before.rotation, before.translation, before.rotation_95, before.translation_95]
    for row in rows:
        known = [*within_bounds(row), *within_bounds(row, "_95")]
        if row.solved and len(known) == 4:
            counts = [count + is_covered for count, is_covered in zip(counts, (True, *known), strict=True)]
    return BoundCoverage(*counts)


def within_bounds(row: StoredRow, suffix: str = "") -> list[bool]:
    """Return whether the rotation and the translation error are within the predicted one, where both are known."""
    errors = ("rotation_deg", row.rotation_deg), ("translation_m", row.translation_m)
    pairs = [(error, predicted(row, f"{name}{suffix}")) for name, error in errors]
    return [error <= bound for error, bound in pairs if error is not None and bound is not None]


def false_accepts(rows: Iterable[StoredRow]) -> int:
    """Return the number of trusted results with a larger error than `WRONG`."""
    return sum(wrong(row) for row in rows if row.trust is Trust.TRUSTED)


def pooled(rows: Iterable[StoredRow]) -> list[str]:
    """Return lines on the coverage of predicted errors and on wrong trusted results over all rows."""
    coverage, lines, trusted, false_accept_count = NONE, [], 0, 0
    for row in rows:
        coverage = bound_coverage([row], coverage)
        trusted += row.trust is Trust.TRUSTED
        false_accept_count += false_accepts([row])
    if coverage.count:
        counts = (coverage.rotation, coverage.translation, coverage.rotation_95, coverage.translation_95)
        shares = (
            "{} of rotations and {} of translations (67 % expected), {} of rotations and {} of translations"
            " (95 % expected)".format(*(f"{100 * number / coverage.count:.0f} %" for number in counts))
        )
        lines.append(f"Coverage of the predicted errors of {coverage.count} runs: {shares}")
    if trusted:
        lines.append(f"Trusted: {trusted} runs, {false_accept_count} of them {WRONG_TEXT}")
    return lines


def wrong(row: StoredRow) -> bool:
    """Return whether the known error of a result is larger than `WRONG`."""
    sizes = (row.rotation_deg, WRONG.angle_deg), (row.translation_m, WRONG.distance_m)
    return any(error is not None and error > bound for error, bound in sizes)
