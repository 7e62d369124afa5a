"""Results of calibrators whose verdict follows from their status."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from p2o import Result, Status


def decided(result: Result, **changes: Any) -> Result:
    """Return a result with these changes and the verdict that follows from its new status."""
    fields: dict[str, Any] = {"verdict": None, **changes}
    return replace(result, **fields)


def refused(result: Result, reason: str, status: Status = Status.NO_FEATURES) -> Result:
    """Return an unsolved result with the status and the reason of its refusal."""
    return decided(result, status=status, reason=reason)
