"""The ten slots: what a method can be, and by which words users choose and set it.

Whatever lists slots, stages or their words takes them from `SLOTS`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum


class Kind(StrEnum):
    """The ten slots; the value is what `p2o methods` prints, `hook` the hook that offers methods of the kind."""

    IMAGE_EXTRACTOR = "image extractor"
    CLOUD_EXTRACTOR = "cloud extractor"
    MATCHER = "matcher"
    SOLVER = "solver"
    INITIALIZER = "initializer"
    CALIBRATOR = "calibrator"
    ACCUMULATOR = "accumulator"
    DATASET = "dataset"
    EXPORTER = "exporter"
    CALIBRATION_READER = "calibration reader"

    @property
    def hook(self) -> str:
        """Name of the hook, such as p2o_image_extractors."""
        return "p2o_" + self.value.replace(" ", "_") + "s"


@dataclass(frozen=True)
class Slot:
    """One slot.

    `stage` names the method in a plan, and its options in --set STAGE.FIELD=VALUE. `word` is the word of a recipe or
    study file that chooses it, and its option on the command line; both extractors share one, IMAGE/CLOUD. `sensor` is
    the input of an extractor, else "". `staged` methods make up the pipeline, which a calibrator replaces. `in_recipe`
    is False if a recipe does not name the method. `syntax` is how the command line sets an option of a method.
    """

    kind: Kind
    stage: str
    word: str
    sensor: str = ""
    staged: bool = False
    in_recipe: bool = True
    syntax: str = "--set {stage}.{field}={value}"

    @property
    def option(self) -> str:
        """The option of the command line that chooses a method, such as --matcher."""
        return f"--{self.word}"

    def setting(self, name: str, field: str, value: str) -> str:
        """Return the words of the command line that set an option of the method `name`."""
        return self.syntax.format(stage=self.stage, name=name, field=field, value=value)

    def spec(self, name: str, others: Mapping[str, str]) -> str:
        """Return what to write for `word` to choose the method `name` beside `others`, method names by stage."""
        names = {**others, self.stage: name}
        return "/".join(names[slot.stage] for slot in SLOTS if slot.word == self.word)


SLOTS = (
    Slot(Kind.DATASET, "data", "data"),
    Slot(Kind.IMAGE_EXTRACTOR, "extractor", "extractor", sensor="image", staged=True),
    Slot(Kind.CLOUD_EXTRACTOR, "cloud", "extractor", sensor="cloud", staged=True),
    Slot(Kind.MATCHER, "matcher", "matcher", staged=True),
    Slot(Kind.SOLVER, "solver", "solver", staged=True),
    Slot(Kind.INITIALIZER, "init", "init", staged=True),
    Slot(Kind.CALIBRATOR, "calibrator", "calibrator"),
    Slot(Kind.ACCUMULATOR, "accumulate", "accumulate"),
    # Exports are repeated texts NAME:PATH?FIELD=VALUE; a reader is chosen by the content of a file, or by its name.
    Slot(Kind.EXPORTER, "export", "export", in_recipe=False, syntax="--export {name}:PATH?{field}={value}"),
    Slot(Kind.CALIBRATION_READER, "read", "from", in_recipe=False, syntax="FILE?form={name}&{field}={value}"),
)

SLOT_OF = {slot.kind: slot for slot in SLOTS}
"""The slot of each kind of method."""

KIND_OF = {slot.stage: slot.kind for slot in SLOTS if slot.in_recipe}
"""The kind of method that each stage of a recipe takes."""

STAGES = (*KIND_OF, "pipeline")
"""The stages that options are set for: those of methods, and the pipeline that runs them."""

STAGED_WORDS = tuple(dict.fromkeys(slot.word for slot in SLOTS if slot.staged))
"""The words of a recipe that a calibrator replaces."""

METHOD_WORDS = (*STAGED_WORDS, SLOT_OF[Kind.CALIBRATOR].word)
"""The words of a recipe that choose methods for frames."""

EXTRACTORS = ("extractor", "cloud")
"""The stages of a plan that extract features."""
WITNESS = ("witness", "witness-cloud")
"""The stages of a plan that extract the edges of the independent check."""
WIDE = "wide"
"""The stage of a plan that searches a whole box of poses if the result of a rough initial guess is not trusted."""
WITNESS_STAGES = {"matcher": "witness-matcher", "solver": "witness-solver", "init": "witness-init"}
"""The stages of a plan that solve the independent check, by the stage of a pipeline."""
