"""The calibration file formats of this package by name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping

from p2o import UnknownNameError

from p2o_formats import hooks
from p2o_formats.format import Format


def _named(*places: str) -> Mapping[str, Format]:
    parts = (place.partition(":") for place in places)
    forms = [getattr(importlib.import_module(f"p2o_formats.{module}"), name) for module, _, name in parts]
    return {form.name: form for form in forms}


WRITTEN = _named(*hooks.WRITTEN)
"""The formats that can be written."""

FORMATS = {**WRITTEN, **_named(*hooks.READ_ONLY)}
"""All formats."""


def format_named(name: str, where: object = None) -> Format:
    """Return the format of a name; raises UnknownNameError for any other name."""
    if name not in FORMATS:
        raise UnknownNameError("form of calibration file", name, WRITTEN, where=where)
    return FORMATS[name]
