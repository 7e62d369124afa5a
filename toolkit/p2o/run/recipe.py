"""A recipe: the words that say what to run. Resolving it finds, checks and fits everything before data are read."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from pydantic import BaseModel, ConfigDict, Field

from p2o.errors import InputError, UnknownNameError
from p2o.host.method import Kind, Method
from p2o.host.options import Options
from p2o.host.registry import Offer, Registry
from p2o.host.slots import KIND_OF, SLOTS, STAGED_WORDS
from p2o.host.slots import STAGE_OF as STAGE_OF
from p2o.host.slots import STAGES as STAGES
from p2o.host.validation import validated as validated
from p2o.run.words import parse_settings as parse_settings
from p2o.run.words import split_data as split_data
from p2o.run.words import value_of as value_of

if TYPE_CHECKING:
    from p2o.frames.frame import Frame
    from p2o.host.guard import GuardedDataset
    from p2o.host.stages import Calibrator, Exporter


class Recipe(BaseModel):
    """What to run, in words; what is left out takes the default here, and nowhere else.

    `data` is DATASET:PATH, or None where frames are handed over in Python; `frames` says which of them; `extractor`
    is IMAGE/CLOUD; `calibrator` replaces extractor, matcher, solver and init by one whole method; `options` maps
    stage to field to value; `perturb` is a text such as "2deg 0.15m"; `joint` gives one result for all frames.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    data: str | None = "synthetic:"
    frames: str = "all"
    extractor: str = "p2ornet/rings"
    matcher: str = "ogm"
    solver: str = "lm"
    init: str = "search"
    calibrator: str | None = None
    options: dict[str, dict[str, Any]] = Field(default_factory=dict)
    perturb: str | None = None
    seed: int = Field(default=0, ge=0)
    joint: bool = False

    @classmethod
    def of(cls, **words: Any) -> Recipe:
        """Return the recipe of these words, leaving out those that are None.

        Raises InputError that names the word, its value and what it must be.
        """
        said = {name: value for name, value in words.items() if value is not None}
        if "data" in words and words["data"] is None:
            said["data"] = None
        return validated(cls, said, "recipe")

    def resolve(self, registry: Registry) -> Plan:
        """Find every method, validate every option and check that the stages fit; no data are read.

        Raises UnknownNameError for unknown names and stages, InputError for bad options and for stages that do not
        fit, PluginError where a name is offered twice.
        """
        from p2o.calibration.pipeline import PipelineOptions
        from p2o.geometry.perturb import parse_perturbation

        if self.perturb is not None:
            parse_perturbation(self.perturb)
        names, said = self._names()
        for stage in self.options:
            if stage not in STAGES:
                raise UnknownNameError("stage", stage, STAGES, where="options")
            if stage not in names and stage != "pipeline":
                raise InputError(f"options for {stage}, which this recipe does not use", expected=", ".join(names))
        parts: dict[str, Part] = {}
        for stage, name in names.items():
            values = {**said.get(stage, {}), **self.options.get(stage, {})}
            parts[stage] = _part(registry.find(KIND_OF[stage], name), stage, values, self.seed)
        if self.calibrator is None:
            pipeline = validated(PipelineOptions, {"seed": self.seed, **self.options.get("pipeline", {})}, "pipeline")
        elif "pipeline" in self.options:
            raise InputError(f"options for the pipeline, which calibrator '{self.calibrator}' does not use")
        else:
            pipeline = None
        _check_fit(parts, registry)
        return Plan(self, parts, pipeline, registry)

    def _names(self) -> tuple[dict[str, str], dict[str, dict[str, Any]]]:
        """Return the method name of each stage, and options that the data text holds."""
        names: dict[str, str] = {}
        said: dict[str, dict[str, Any]] = {}
        if self.data is not None:
            names["data"], said["data"] = split_data(self.data)
        if self.calibrator is not None:
            extra = sorted(self.model_fields_set.intersection(STAGED_WORDS))
            if extra:
                raise InputError(
                    f"calibrator '{self.calibrator}' is a whole method",
                    expected="no " + ", ".join(extra) + " beside it",
                )
            return {**names, "calibrator": self.calibrator}, said
        image, slash, cloud = self.extractor.partition("/")
        if not (slash and image and cloud) or "/" in cloud:
            raise InputError(
                "an extractor is a pair of methods", expected="IMAGE/CLOUD, such as p2ornet/rings", got=self.extractor
            )
        return {
            **names,
            "extractor": image,
            "cloud": cloud,
            "matcher": self.matcher,
            "solver": self.solver,
            "init": self.init,
        }, said


@dataclass(frozen=True)
class Part:
    """One method of a plan with its validated options."""

    offer: Offer
    options: Options

    def build(self) -> Any:
        """Return the guarded stage; heavy packages are imported here."""
        from p2o.host.guard import build

        return build(self.offer, self.options)


@dataclass(frozen=True)
class Plan:
    """A resolved recipe: every method found, every option validated, every stage fitting the next."""

    recipe: Recipe
    parts: Mapping[str, Part]
    pipeline: Options | None
    registry: Registry

    def dataset(self) -> GuardedDataset:
        """Return the dataset; its frames are read when they are asked for."""
        dataset: GuardedDataset = self.parts["data"].build()
        return dataset

    def calibrator(self) -> Calibrator:
        """Return what makes a result of frames: the `Pipeline` of the stages, or the whole method."""
        from p2o.calibration.pipeline import Pipeline, PipelineOptions

        calibrator: Calibrator
        if "calibrator" in self.parts:
            calibrator = self.parts["calibrator"].build()
            return calibrator
        if not isinstance(self.pipeline, PipelineOptions):
            raise TypeError("a plan without calibrator has pipeline options")
        calibrator = Pipeline(
            image_extractor=_remembering(self.parts["extractor"].build()),
            cloud_extractor=_remembering(self.parts["cloud"].build()),
            matcher=self.parts["matcher"].build(),
            solver=self.parts["solver"].build(),
            initializer=self.parts["init"].build(),
            options=self.pipeline,
            directed="side" in self.parts["matcher"].offer.method.needs,
        )
        return calibrator

    def check_frame(self, frame: Frame) -> None:
        """Raise InputError where a method needs what this frame does not hold, with what would fit instead."""
        held = frozenset(word for word, find in _HELD.items() if find(frame) is not None)
        offers = {stage: part.offer for stage, part in self.parts.items()}
        # Frames that are handed over in Python have no dataset: stand in one that gives nothing for certain.
        blank = Method(name="frame", build=dict, summary="Frames of Python.", gives=frozenset({"frames"}))
        offers.setdefault("data", Offer(Kind.DATASET, blank, "", "", ""))
        misfit = _misfit(offers, held)
        if misfit is not None:
            word, _, user = misfit
            raise InputError(
                f"the frame has no {word}; {user.name} needs it",
                where=frame.name,
                hint=_way_out(offers, self.registry, user, held),
            )

    def described(self) -> dict[str, Any]:
        """Return the recipe with every option that took effect, ready for JSON; `Recipe.of(**it)` repeats the run."""
        unused = set(STAGED_WORDS) if self.recipe.calibrator is not None else {"calibrator"}
        words = self.recipe.model_dump(mode="json", exclude=unused)
        words["options"] = {stage: part.options.model_dump(mode="json") for stage, part in self.parts.items()}
        if self.pipeline is not None:
            words["options"]["pipeline"] = self.pipeline.model_dump(mode="json")
        return words

    def versions(self) -> dict[str, str]:
        """Return the versions of everything that had a part in it."""
        import platform
        from importlib.metadata import PackageNotFoundError, version

        out = {"python": platform.python_version()}
        for name in ("p2o-calib", "numpy", "scipy", "opencv-contrib-python-headless", "pycolmap", "pyceres", "torch"):
            try:
                out[name] = version(name)
            except PackageNotFoundError:
                continue
        out.update({part.offer.dist: part.offer.version for part in self.parts.values() if part.offer.version})
        return out


def open_dataset(data: str, registry: Registry, options: Mapping[str, Any] | None = None) -> GuardedDataset:
    """Return the dataset of a text DATASET:PATH; its frames are read when they are asked for.

    Raises as `Recipe.resolve`.
    """
    dataset: GuardedDataset = dataset_part(data, registry, options).build()
    return dataset


def dataset_part(data: str, registry: Registry, options: Mapping[str, Any] | None = None) -> Part:
    """Return the method and the validated options of a text DATASET:PATH; nothing is opened.

    Raises as `Recipe.resolve`.
    """
    name, values = split_data(data)
    return _part(registry.find(Kind.DATASET, name), "data", {**values, **(options or {})}, Recipe().seed)


def open_exporter(text: str, registry: Registry) -> tuple[Exporter, Path]:
    """Return the exporter of a text NAME:PATH (or NAME:PATH?field=value), and the path.

    Raises UnknownNameError for an unknown exporter, InputError where the path is missing or an option is bad.
    """
    name, values = split_data(text)
    path = values.pop("root", None)
    if path is None:
        raise InputError("an export needs a path", where="--export", expected="NAME:PATH, such as json:result.json")
    exporter: Exporter = _part(registry.find(Kind.EXPORTER, name), "export", values, Recipe().seed).build()
    return exporter, Path(path)


def _part(offer: Offer, stage: str, values: dict[str, Any], seed: int) -> Part:
    """Return the method with its options validated; a field called `seed` follows the recipe's unless it is set."""
    fields = offer.method.options.model_fields
    if stage == "data" and "root" in values and "root" not in fields:
        raise InputError(f"dataset {offer.name} takes no path", expected=f"{offer.name}:", got=values["root"])
    if stage == "data" and "root" in fields and fields["root"].is_required() and "root" not in values:
        raise InputError(f"dataset {offer.name} needs a path", expected=f"{offer.name}:PATH")
    if "seed" in fields:
        values = {"seed": seed, **values}
    return Part(offer, validated(offer.method.options, values, stage))


def _remembering(extract: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Return the extractor with a memory that lasts as long as the image or sweep: pictures reuse its features."""
    known: WeakKeyDictionary[Any, Any] = WeakKeyDictionary()

    def remembered(data: Any, /) -> Any:
        if data not in known:
            known[data] = extract(data)
        return known[data]

    return remembered


def missing_words(needs: Iterable[str], upstream: Sequence[Offer]) -> list[tuple[str, Offer]]:
    """Return the needed words that are not given, each with the method that would have to give it.

    `upstream` are the methods before: both extractors, the matcher, or the dataset.
    """
    missing = []
    by_kind = {offer.kind: offer for offer in upstream}
    for word in sorted(needs):
        if word.startswith("image-") and Kind.IMAGE_EXTRACTOR in by_kind:
            givers = [by_kind[Kind.IMAGE_EXTRACTOR]]
        elif word.startswith("cloud-") and Kind.CLOUD_EXTRACTOR in by_kind:
            givers = [by_kind[Kind.CLOUD_EXTRACTOR]]
        else:
            givers = list(upstream)
        for giver in givers:
            # What a frame may hold is only known when it is read; a dataset that declares nothing may give anything.
            open_yet = giver.kind == Kind.DATASET and (word in _HELD or not giver.method.gives)
            # Pairs are a cost as well: their robust sum.
            given = word in giver.method.gives or (word == "objective" and "pairs" in giver.method.gives)
            if not given and not open_yet:
                missing.append((word, giver))
    return missing


_HELD: dict[str, Callable[[Frame], object]] = {
    "right": lambda frame: frame.image.right,
    "depth": lambda frame: frame.image.depth_m,
    "rings": lambda frame: frame.cloud.ring,
    "intensity": lambda frame: frame.cloud.intensity,
    "time": lambda frame: frame.cloud.time_s,
    "twist": lambda frame: frame.twist,
}
"""The words for what a frame may hold, and where it holds it."""

_OPTION_OF = {slot.kind: slot.option for slot in SLOTS}


def _misfit(offers: Mapping[str, Offer], held: frozenset[str] | None = None) -> tuple[str, Offer, Offer] | None:
    """Return the first word that is needed and not given: the word, who should give it, who needs it.

    `held` are the words that the frames are known to hold, once one has been read.
    """
    extractors = [offers[stage] for stage in ("extractor", "cloud") if stage in offers]
    data = [offers["data"]] if "data" in offers else []
    upstream = {
        "extractor": data,
        "cloud": data,
        "calibrator": data,
        "matcher": extractors,
        "init": extractors,
        "solver": [offers["matcher"]] if "matcher" in offers else [],
    }
    for stage, before in upstream.items():
        if stage not in offers or not before:
            continue
        needs = offers[stage].method.needs
        for word, giver in missing_words(needs, before):
            return word, giver, offers[stage]
        if held is not None and before is data:
            for word in sorted((needs & _HELD.keys()) - held - data[0].method.gives):
                return word, data[0], offers[stage]
    return None


def _way_out(offers: Mapping[str, Offer], registry: Registry, user: Offer, held: frozenset[str] | None = None) -> str:
    """Return what to write instead of the method `user` so that everything fits, or that there is nothing."""
    stage = STAGE_OF[user.kind]
    fitting = [o for o in registry.of_kind(user.kind) if _misfit({**offers, stage: o}, held) is None]
    if not fitting:
        return f"no installed {user.kind} fits in its place (`p2o methods --matrix` shows what does)"
    names = [offer.name for offer in fitting[:4]]
    if user.kind == Kind.IMAGE_EXTRACTOR:
        names = [f"{name}/{offers['cloud'].name}" for name in names]
    elif user.kind == Kind.CLOUD_EXTRACTOR:
        names = [f"{offers['extractor'].name}/{name}" for name in names]
    return f"try {_OPTION_OF[user.kind]} {' or '.join(names)}"


def _check_fit(parts: Mapping[str, Part], registry: Registry) -> None:
    """Raise InputError where a method needs what nothing before it gives, with what would fit instead."""
    offers = {stage: part.offer for stage, part in parts.items()}
    misfit = _misfit(offers)
    if misfit is not None:
        word, giver, user = misfit
        raise InputError(f"{giver.name} gives no {word}; {user.name} needs it", hint=_way_out(offers, registry, user))
