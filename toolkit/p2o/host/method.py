"""A method is a value: its name, its options, how to build it, and what it needs and gives."""

from __future__ import annotations

import re
from collections.abc import Callable, Set
from dataclasses import dataclass
from typing import Any

from p2o.errors import PluginError
from p2o.host.slots import Kind as Kind
from p2o.host.trainer import Trainer
from p2o.options import Options


@dataclass(frozen=True)
class Example:
    """Frames on which a method promises to come near the truth, for `p2o check-plugin` and its own tests.

    `data` is DATASET:PATH of a dataset that needs no files, `perturb` the start, `within` what the result must reach
    as in `p2o run`; `joint` calibrates all frames together, `accumulate` joins their sweeps before. A matcher says
    which `extractor` (IMAGE/CLOUD), `solver` and `init` go with it, and what to set besides (`settings`, as for
    `--set`: "pipeline.rounds=1"); what is left out takes the default of a recipe.
    """

    data: str
    perturb: str = "1deg 0.05m"
    within: str = "0.3deg 0.1m"
    joint: bool = False
    extractor: str = ""
    solver: str = ""
    init: str = ""
    accumulate: str = ""
    settings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Method:
    """One method that a plugin offers.

    `name` is a slug (a-z, 0-9, -); `build(options)` returns the stage and may import heavy packages; `summary` is one
    sentence; `needs` and `gives` are words: prefixed ones (image-edges, cloud-edges, pairs, objective) must be given
    by the side they name, unprefixed ones (side) by both sides. `cite` names the source. `extra` is the extra of
    p2o-calib, or the package, that has to be installed for it. `expected_failures` maps names of conformance checks
    that the method is known to fail to the reason. `trainer` says how the method learns, where it does. `example` is
    what a method of frames that the test stage does not have (targets, drives) promises to succeed on. With `parallel`
    an extractor may be called, or a dataset read, from several threads at once and gives the same: several frames then
    use all cores.
    """

    name: str
    build: Callable[[Any], Any]
    summary: str
    options: type[Options] = Options
    needs: Set[str] = frozenset()
    gives: Set[str] = frozenset()
    cite: str = ""
    extra: str = ""
    expected_failures: tuple[tuple[str, str], ...] = ()
    trainer: Trainer | None = None
    example: Example | None = None
    parallel: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "needs", frozenset(self.needs))
        object.__setattr__(self, "gives", frozenset(self.gives))
        if not isinstance(self.name, str) or not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", self.name):
            raise PluginError(f"bad method name {self.name!r}", expected="a slug of a-z, 0-9 and -")
        if not callable(self.build):
            raise PluginError(f"method {self.name}: build cannot be called", expected="a function of the options")
        if not (isinstance(self.options, type) and issubclass(self.options, Options)):
            raise PluginError(f"method {self.name}: options are not options", expected="a subclass of p2o.Options")
        if self.trainer is not None and not isinstance(self.trainer, Trainer):
            raise PluginError(f"method {self.name}: its trainer is none", expected="p2o.Trainer")
        if not self.summary:
            raise PluginError(f"method {self.name} has no summary", expected="one sentence")
