"""The worst run of a row, and its outcome in words."""

from __future__ import annotations

import math
from collections.abc import Sequence

from p2o.results.verdict import Trust

from p2o_study.row import Row
from p2o_study.statistics import BOUNDS, is_covered, is_worse, is_wrong


def error_rank(run: Row) -> tuple[float, int]:
    """Return a sort key of runs: the rotation error, then the verdict."""
    error = -1.0 if run.error is None else run.error.rotation_deg
    return error, -1 if run.trust is None else list(Trust).index(run.trust)


def worst_run(runs: Sequence[Row]) -> Row:
    """Return the first run with the highest `error_rank`; runs that raised have no error."""
    return max(runs, key=error_rank)


def outcome_text(run: Row) -> str:
    """Describe status, error and verdict of a run in a few sentences."""
    if run.crashed:
        raised = (run.exception or "").strip().splitlines()
        return _sentence(f"The run raised: {run.reason or (raised[-1] if raised else 'no reason stated')}")
    off = _size(run.error_of("rotation_deg"), run.error_of("translation_m"))
    begin = _size(run.start_error_of("rotation_deg"), run.start_error_of("translation_m"))
    since = f"; error of the initial guess: {begin}" if begin else ""
    if not run.solved:
        stays = f" The result is the initial guess, error {off}." if off else " The result is the initial guess."
        return _sentence(f"The run was refused ({run.status}): {run.reason}") + stays
    if not off:
        parts = ["The error is unknown: there is no ground truth."]
    elif run.unmoved:
        parts = [f"The result is the initial guess, error {off}: the solver did not move."]
    elif is_worse(run):
        parts = [f"The result is worse than the initial guess: error {off}{since}."]
    elif is_wrong(run):
        parts = [f"The error is still large: {off}{since}."]
    else:
        parts = [f"The result is good: error {off}{since}."]
    return " ".join([*parts, *_verdict_texts(run)])


def _verdict_texts(run: Row) -> list[str]:
    """Return sentences on the verdict and on the coverage of the predicted error."""
    parts = []
    if run.trust is Trust.TRUSTED:
        parts.append("The verdict is trusted, a false accept." if is_wrong(run) else "The verdict is trusted.")
    elif run.trust is not None:
        parts.append(_sentence(f"The verdict is {run.trust}{f': {run.why}' if run.why else ''}"))
    bound = _size(run.predicted("rotation_deg_95"), run.predicted("translation_m_95"))
    if bound:
        known = [covered for name, covered in is_covered(run).items() if name in BOUNDS[2:]]
        relation = "" if not known else ", which covers the error" if all(known) else ", less than the error"
        parts.append(f"The predicted error (95 %) is {bound}{relation}.")
    return parts


def _size(angle_deg: float | None, length_m: float | None) -> str:
    """Return an error as text, "" if it is unknown or infinite."""
    parts = []
    if angle_deg is not None and math.isfinite(angle_deg):
        parts.append(f"{angle_deg:.2f} deg")
    if length_m is not None and math.isfinite(length_m):
        parts.append(f"{100 * length_m:.1f} cm")
    return " and ".join(parts)


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."
