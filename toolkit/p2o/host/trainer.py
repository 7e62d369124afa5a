"""How a method learns: what `p2o labels` and `p2o train` ask of it. No method is imported here, nor torch."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from p2o.errors import PluginError
from p2o.options import Options

if TYPE_CHECKING:
    from p2o.arrays import UInt8
    from p2o.frames.frame import Frame


@dataclass(frozen=True)
class TrainingGroup:
    """Label files of one origin; `share` > 0 says how much of the training they make up, against other groups."""

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

    `options` are those of a training, `presets` named sets of them. `label(frame)` returns the content of a label
    file, whose name ends in `suffix`; it sees the true extrinsic. Raise `label_version` when it would return something
    else than before: old files are then made anew. `draw(path)` returns a label file as a picture (H, W, 3) uint8.

    `train(options, groups, validation, out, report)` learns from label files into the existing folder `out` and
    returns the file of weights. Called again with the same arguments it goes on where it was; where `out` holds
    another training it raises InputError. It calls `report` now and then; what `report` raises ends it. If it writes
    `out/log.csv` with the columns step, loss, validation and learning_rate, curves are drawn of it. The method's
    option `weights_option` takes the file.
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
