"""Declaration of a method: its name, its options, how to build it, what it needs and gives, and how it is trained."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from p2o.errors import PluginError
from p2o.host.slots import Kind as Kind
from p2o.options import Options

if TYPE_CHECKING:
    from p2o.arrays import Int, UInt8
    from p2o.frames.cloud import Cloud
    from p2o.frames.frame import Frame


@dataclass(frozen=True)
class TrainingGroup:
    """Label files of one origin; `share` > 0 is their weight in the training relative to other groups."""

    name: str
    paths: Sequence[Path]
    share: float


@dataclass(frozen=True)
class TrainingProgress:
    """Where a training stands: `step` of `of`, mean `loss` since the last report, loss on what was held out."""

    step: int
    of: int
    loss: float
    validation: float | None
    seconds: float


Report = Callable[[TrainingProgress], None]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trainer:
    """How a method is trained; its functions may import heavy packages when they are called.

    `options` are those of a training, `presets` named sets of them. `label(frame)` returns the content of a label file,
    whose name ends in `suffix`; it sees the true extrinsic. Raise `label_version` when its output changes: old files
    are then created again. `draw(path)` renders a label file as an image (H, W, 3) uint8. `train(options, groups,
    validation, out, report)` learns from label files into the existing folder `out` and returns the file of weights.
    Called again with the same arguments it goes on where it was; where `out` holds another training it raises
    InputError. It calls `report` now and then; what `report` raises ends it. If it writes `out/log.csv` with the
    columns step, loss, validation and learning_rate, curves are drawn of it. The method's option `weights_option` takes
    the file.
    """

    options: type[Options]
    label: Callable[[Frame], bytes]
    draw: Callable[[Path], UInt8]
    train: Callable[[Any, Sequence[TrainingGroup], Sequence[Path], Path, Report], Path]
    presets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    label_version: int = 1
    suffix: str = ".npz"
    weights_option: str = "weights"

    def __post_init__(self) -> None:
        if not (isinstance(self.options, type) and issubclass(self.options, Options)):
            raise PluginError("options of a trainer are not options", expected="a subclass of p2o.Options")
        for name in ("label", "draw", "train"):
            if not callable(getattr(self, name)):
                raise PluginError(f"a trainer's {name} cannot be called", expected="a function")
        if not self.suffix.startswith(".") or "/" in self.suffix or self.suffix == ".png":
            raise PluginError("bad suffix of label files", expected="such as .npz, not .png", got=self.suffix)


PLUGIN_API = 1
"""Version of the author API (`p2o`, `p2o.solving`, `p2o.reading`); a removed name, field or parameter raises it."""


@dataclass(frozen=True)
class Example:
    """Frames on which a method promises to come near the truth, for `p2o plugin check` and its own tests.

    `data` is DATASET:PATH of a dataset that needs no files, `perturb` the initial guess, `within` the required
    accuracy as in `p2o run`; `joint` calibrates all frames jointly, `accumulate` accumulates their sweeps before. A
    matcher names its `extractor` (IMAGE/CLOUD), `solver` and `init`, and further options (`settings`, as for `--set`:
    "pipeline.rounds=1"); omitted values have the default of a recipe.
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
    by the side they name, unprefixed ones (side) by both sides. An exporter that gives `verdict` stores the verdict, so
    that it also receives results that are not trusted. `cite` names the source. `extra` is the extra of
    p2o-calib, or the package, that has to be installed for it. `expected_failures` maps names of conformance checks
    that the method is known to fail to the reason. `trainer` defines the training of the method, if any. `example` is
    what a method of frames that the test stage does not have (targets, drives) promises to succeed on. With `parallel`
    an extractor may be called, or a dataset read, from several threads at once and gives the same: several frames then
    use all cores. `data_files(options)` returns the files of the package (weights, tables) that `build(options)` reads:
    stored results are computed again when one of them changes. Without it, all data files of the package count if the
    method locates its package. Files that options name by their path need not be declared. `data_licence(options)`
    returns the licence of these files in one line, which results state, or an empty text. `rings(cloud)` of a cloud
    extractor returns the rings (N,) that it recovers of a cloud whose order and elevations do not show them, and from
    what, or None: `p2o data check` reports them.
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
    data_files: Callable[[Any], Iterable[Path]] | None = None
    data_licence: Callable[[Any], str] | None = None
    rings: Callable[[Cloud], tuple[Int, str] | None] | None = None
    recognises: Callable[[Path], bool] | None = None

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

    @cached_property
    def option_names(self) -> tuple[str, ...]:
        """Names of the options."""
        return tuple(self.options.model_fields)
