"""The nine slots: what a method can be, and by which words users choose and set it.

Whatever lists slots, stages or their words takes them from `SLOTS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """The nine slots; the value is what `p2o methods` prints, `hook` the hook that offers methods of the kind."""

    IMAGE_EXTRACTOR = "image extractor"
    CLOUD_EXTRACTOR = "cloud extractor"
    MATCHER = "matcher"
    SOLVER = "solver"
    INITIALIZER = "initializer"
    CALIBRATOR = "calibrator"
    ACCUMULATOR = "accumulator"
    DATASET = "dataset"
    EXPORTER = "exporter"

    @property
    def hook(self) -> str:
        """Name of the hook, such as p2o_image_extractors."""
        return "p2o_" + self.value.replace(" ", "_") + "s"


@dataclass(frozen=True, kw_only=True)
class Slot:
    """One slot.

    `stage` names the method in a plan, and its options in --set STAGE.FIELD=VALUE. `word` is the word of a recipe or
    study file that chooses it, and its option on the command line; both extractors share one, IMAGE/CLOUD. `sensor`
    is the part of a frame that an extractor looks at, else "". `staged` methods make up the pipeline, and a
    calibrator takes the place of all of them. `in_recipe` is False where a recipe does not say the method.
    """

    kind: Kind
    stage: str
    word: str
    sensor: str = ""
    staged: bool = False
    in_recipe: bool = True

    @property
    def hook(self) -> str:
        """Name of the hook that offers its methods."""
        return self.kind.hook

    @property
    def option(self) -> str:
        """The option of the command line that chooses a method, such as --matcher."""
        return f"--{self.word}"

    def setting(self, name: str, field: str, value: str) -> str:
        """Return the words of the command line that set an option of the method `name`."""
        if not self.in_recipe:
            return f"{self.option} {name}:PATH?{field}={value}"
        return f"--set {self.stage}.{field}={value}"

    def said(self, name: str, others: Mapping[str, str]) -> str:
        """Return what to write for `word` to choose the method `name` beside `others`, method names by stage."""
        names = {**others, self.stage: name}
        return "/".join(names[slot.stage] for slot in SLOTS if slot.word == self.word)


SLOTS = (
    Slot(kind=Kind.DATASET, stage="data", word="data"),
    Slot(kind=Kind.IMAGE_EXTRACTOR, stage="extractor", word="extractor", sensor="image", staged=True),
    Slot(kind=Kind.CLOUD_EXTRACTOR, stage="cloud", word="extractor", sensor="cloud", staged=True),
    Slot(kind=Kind.MATCHER, stage="matcher", word="matcher", staged=True),
    Slot(kind=Kind.SOLVER, stage="solver", word="solver", staged=True),
    Slot(kind=Kind.INITIALIZER, stage="init", word="init", staged=True),
    Slot(kind=Kind.CALIBRATOR, stage="calibrator", word="calibrator"),
    Slot(kind=Kind.ACCUMULATOR, stage="accumulate", word="accumulate"),
    # Written as one text NAME:PATH?FIELD=VALUE, as often as wanted.
    Slot(kind=Kind.EXPORTER, stage="export", word="export", in_recipe=False),
)

SLOT_OF = {slot.kind: slot for slot in SLOTS}
"""The slot of each kind of method."""

KIND_OF = {slot.stage: slot.kind for slot in SLOTS if slot.in_recipe}
"""The kind of method that each stage of a recipe takes."""

STAGE_OF = {kind: stage for stage, kind in KIND_OF.items()}
"""The word before the dot in --set, by kind of method; an exporter has none."""

STAGES = (*KIND_OF, "pipeline")
"""The stages that options are set for: those of methods, and the pipeline that runs them."""

STAGED_WORDS = tuple(dict.fromkeys(slot.word for slot in SLOTS if slot.staged))
"""The words of a recipe that a calibrator replaces."""

METHOD_WORDS = (*STAGED_WORDS, SLOT_OF[Kind.CALIBRATOR].word)
"""The words of a recipe that choose methods for frames."""

SENSORS = {slot.stage: slot.sensor for slot in SLOTS if slot.sensor}
"""The part of a frame that each extractor looks at, by stage."""
WITNESS = ("witness", "witness-cloud")
"""What extracts the edges by which a result is checked whose method has none: stages of a plan."""
WITNESS_STAGES = {"matcher": "witness-matcher", "solver": "witness-solver", "init": "witness-init"}
"""The stages of a plan that tell where those edges lead, by what they are of a pipeline."""
