"""Import packages of extras, which may not be installed."""

from __future__ import annotations

import importlib
from typing import Any

from p2o.errors import MethodUnavailable


def optional_package(name: str, user: str, packages: str) -> Any:
    """Return the package `name`, which `user` needs; raises MethodUnavailable with the arguments of pip install."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as problem:
        text = f"{user} needs the package {problem.name}, which is not installed"
        raise MethodUnavailable(text, hint=f"run: pip install {packages}") from problem
