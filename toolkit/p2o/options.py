"""Options of a method: written once as a pydantic model, used by the command line, Python and study files alike."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


class Options(BaseModel):
    """Base of every method's options: frozen, unknown names refused, defaults checked."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)


def field(default: Any, *, help: str, **bounds: Any) -> Any:
    """Return an option field: a default, bounds (gt, ge, lt, le, ...) and the one-sentence description users read."""
    return Field(default, description=help, **bounds)
