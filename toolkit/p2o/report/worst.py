"""The worst run of a row, and in words what went wrong with it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from p2o.results.verdict import Trust
from p2o.study.held import wrong
from p2o.study.store import StoredRow
from p2o.study.tally import farther


def badness(run: StoredRow) -> tuple[float, int]:
    """Return how bad a run is, for comparison: by its rotation error, and where that says nothing by its verdict."""
    error = -1.0 if run.rotation_deg is None else abs(run.rotation_deg)
    return error, -1 if run.trust is None else list(Trust).index(run.trust)


def worst_run(runs: Sequence[StoredRow]) -> StoredRow:
    """Return the worst of some runs, the first of several that are as bad; runs that raised have no error."""
    return max(runs, key=badness)


def what_went_wrong(run: StoredRow) -> str:
    """Return in some sentences how a run ended, how far off it is, and whether it said so."""
    if run.crashed:
        raised = (run.exception or "").strip().splitlines()
        return _sentence(f"It raised: {run.reason or (raised[-1] if raised else 'for no reason told')}")
    off = _size(run.rotation_deg, run.translation_m)
    begin = _size(run.start_rotation_deg, run.start_translation_m)
    since = f", from a start that is {begin} off" if begin else ""
    if not run.solved:
        stays = f" The start stays, which is {off} off." if off else " The start stays."
        return _sentence(f"It was refused ({run.status}): {run.reason}") + stays
    if not off:
        parts = ["How wrong it is nobody knows: there is no truth."]
    elif farther(run):
        parts = [f"It went away from the truth and is {off} off{since}."]
    elif wrong(run):
        parts = [f"It is still {off} off{since}."]
    else:
        parts = [f"Nothing went wrong: it is {off} off{since}."]
    return " ".join([*parts, *_said(run)])


def _said(run: StoredRow) -> list[str]:
    """Return what the run itself said: its verdict, and whether its likely error held."""
    parts = []
    if run.trust is Trust.TRUSTED:
        parts.append(
            "It was called trusted, which it should not have been." if wrong(run) else "It was called trusted."
        )
    elif run.trust is not None:
        parts.append(_sentence(f"It was called {run.trust}{f': {run.why}' if run.why else ''}"))
    bound = _size(run.likely_rotation_deg_95, run.likely_translation_m_95)
    if bound:
        pairs = (
            (run.rotation_deg, run.likely_rotation_deg_95),
            (run.translation_m, run.likely_translation_m_95),
        )
        known = [error <= most for error, most in pairs if error is not None and most is not None]
        held = "" if not known else ", and it is" if all(known) else ", and it is not"
        parts.append(f"19 of 20 such results should be within {bound}{held}.")
    return parts


def _size(angle_deg: float | None, length_m: float | None) -> str:
    """Return an error in words, "" where nothing of it is known; stores hold infinities as texts."""
    parts = []
    if angle_deg is not None and math.isfinite(float(angle_deg)):
        parts.append(f"{float(angle_deg):.2f} deg")
    if length_m is not None and math.isfinite(float(length_m)):
        parts.append(f"{100 * float(length_m):.1f} cm")
    return " and ".join(parts)


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."
