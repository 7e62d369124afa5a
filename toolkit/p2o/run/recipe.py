"""Define and resolve recipes: methods, options and compatibility are checked before data are read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, ConfigDict, Field, StrictBool

from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import nearest, no_such_folder
from p2o.geometry.rough_start import is_rough_start
from p2o.host.method import Kind, Method
from p2o.host.registry import Offer, Registry, watch
from p2o.host.slots import EXTRACTORS, KIND_OF, STAGED_WORDS, STAGES, WIDE, WITNESS, WITNESS_STAGES
from p2o.options import Options, validated
from p2o.run.fit import check_fit, contents_of, misfit_of, suggest_alternative
from p2o.run.part import Part as Part
from p2o.run.part import part_of
from p2o.run.words import split_data, split_name

if TYPE_CHECKING:
    from p2o.frames.frame import Frame
    from p2o.host.calibration_file import InitialGuess
    from p2o.host.guard import GuardedCalibrator, GuardedDataset
    from p2o.host.stages import Exporter
    from p2o.run.assembly import Assembly
    from p2o.run.joined import JoinedFrames
    from p2o.run.pipeline import Pipeline
    from p2o.run.rig import Rig


MOST_SEED = 2**63 - 1
"""Largest integer that every table format supports."""


class Recipe(BaseModel):
    """Specification of a run; omitted fields take the defaults of this class.

    `data` is DATASET:PATH, a path whose dataset is evident, or None if frames are passed in Python; `frames` selects
    them; `extractor` is IMAGE/CLOUD; `calibrator` replaces extractor, matcher, solver and init by one whole method;
    `options` maps stage to field to value; `perturb` is a text such as "2deg 0.15m", or "camera @FILE" for a list of
    starts; `start` states in words where the camera looks (`p2o.geometry.rough_start`; `far` searches again if the
    result of `search` is not trusted), or names a calibration file; `joint` gives one result for all frames. `rig`
    gives one for each camera: True where frames name their camera, else a rig file or its content (`p2o.run.rig`).
    `accumulate` names a method that joins sweeps of a sequence. `witness` is IMAGE/CLOUD, extractors whose edges check
    the results: None takes those of the default recipe, where frames allow it, for methods without directed edges and
    for extractors of other packages; "none" goes without.
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
    start: str | None = Field(default=None, max_length=500)
    seed: int = Field(default=0, ge=0, le=MOST_SEED)
    joint: bool = False
    rig: StrictBool | str | dict[str, Any] = False
    accumulate: str | None = None
    witness: str | None = None

    @classmethod
    def of(cls, **words: Any) -> Recipe:
        """Return the recipe of these words, leaving out those that are None.

        Raises InputError that names the word, its value and what it must be.
        """
        given = {name: value for name, value in words.items() if value is not None or name == "data"}
        return validated(cls, given, "recipe")

    def resolve(self, registry: Registry) -> Plan:
        """Find every method, validate every option and check that the stages fit; no data are read.

        Raises UnknownNameError for unknown names and stages, InputError for bad options and for stages that do not
        fit, PluginError where a name is offered twice.
        """
        guess = self._initial_guess(registry)
        parts = self._parts(registry)
        parts |= _witness(self, parts, registry) | _wide(self, registry)
        pipeline = self._pipeline(parts)
        check_fit({stage: part.offer for stage, part in parts.items()}, registry)
        rig: Rig | None = None
        if self.rig is not False:
            from p2o.run.rig import Rig

            rig = Rig.of(self.rig, registry)
        if rig is not None and self.joint:
            expected = "no --joint beside it: the frames of a camera are solved together in any case"
            raise InputError("a rig has one result for each camera", where="--rig", expected=expected)
        return Plan(self, parts, pipeline, registry, rig, guess)

    def _initial_guess(self, registry: Registry) -> InitialGuess | None:
        """Return the initial guess of `start`; raises InputError for one beside a perturbation, or a bad one."""
        from p2o.geometry.start_list import parse_starts
        from p2o.host.calibration_file import InitialGuess

        if self.perturb is not None:
            parse_starts(self.perturb)
        guess = None if self.start is None else InitialGuess.read(self.start, registry=registry)
        if guess is not None and self.perturb is not None:
            raise InputError("both a start and a perturbation are given", expected="one of them")
        return guess

    def _parts(self, registry: Registry) -> dict[str, Part]:
        """Return the methods that the recipe names, by stage, with their options."""
        for stage in self.options:
            if stage not in (*STAGES, *WITNESS):
                raise UnknownNameError("stage", stage, (*STAGES, *WITNESS), where="options")
        parts: dict[str, Part] = {}
        if self.data is not None:
            parts["data"] = dataset_part(self.data, registry, self.options.get("data"), self.seed)
        for stage, name in self._names().items():
            parts[stage] = part_of(registry.find(KIND_OF[stage], name), stage, self.options.get(stage, {}), self.seed)
        return parts

    def _names(self) -> dict[str, str]:
        """Return the names of the methods by stage, without the dataset."""
        names = {} if self.accumulate is None else {"accumulate": self.accumulate}
        if self.calibrator is not None:
            extra = sorted(self.model_fields_set.intersection(STAGED_WORDS))
            if extra:
                text = f"calibrator '{self.calibrator}' is a whole method"
                raise InputError(text, expected="no " + ", ".join(extra) + " beside it")
            return {**names, "calibrator": self.calibrator}
        names["extractor"], names["cloud"] = _pair("an extractor", self.extractor)
        return {**names, "matcher": self.matcher, "solver": self.solver, "init": self.init}

    def _pipeline(self, parts: Mapping[str, Part]) -> Options | None:
        """Return the options of the pipeline, None for a whole method; raises InputError for options of no stage."""
        from p2o.calibration.options import PipelineOptions

        for stage in self.options:
            if stage not in parts and stage != "pipeline":
                raise InputError(f"options for {stage}, which this recipe does not use", expected=", ".join(parts))
        if self.calibrator is None:
            return validated(PipelineOptions, self.options.get("pipeline", {}), "pipeline")
        if "pipeline" in self.options:
            raise InputError(f"options for the pipeline, which calibrator '{self.calibrator}' does not use")
        return None


_WIDE_SEARCH = "far"
_SELDOM = ("accumulate", "rig", "witness", "start")


def _pair(what: str, text: str) -> tuple[str, str]:
    image, slash, cloud = text.partition("/")
    if not (slash and image and cloud) or "/" in cloud:
        raise InputError(f"{what} is a pair of methods", expected="IMAGE/CLOUD, such as p2ornet/rings", got=text)
    return image, cloud


def _wide(recipe: Recipe, registry: Registry) -> dict[str, Part]:
    """Return the search of a whole box around an initial guess in words; none with another initializer."""
    searches = recipe.calibrator is None and recipe.init == Recipe.model_fields["init"].default
    if not (searches and recipe.start is not None and is_rough_start(recipe.start)):
        return {}
    return _installed(recipe, {WIDE: (Kind.INITIALIZER, _WIDE_SEARCH)}, registry)


def _installed(
    recipe: Recipe, methods: Mapping[str, tuple[Kind, str]], registry: Registry, *, required: bool = False
) -> dict[str, Part]:
    """Return methods of further stages; none if one of them is not installed, unless they are `required`."""
    try:
        return {
            stage: part_of(registry.find(kind, name), stage, recipe.options.get(stage, {}), recipe.seed)
            for stage, (kind, name) in methods.items()
        }
    except UnknownNameError:
        if required:
            raise
        return {}


def _witness(recipe: Recipe, parts: Mapping[str, Part], registry: Registry) -> dict[str, Part]:
    """Return the extractors of the independent check; default ones only if they are installed and fit the data.

    Only edges with directions check the result of the method that uses them: edges without are so dense that they
    agree little more than under random alignment even at a correct pose. Edges of extractors of other packages are
    checked by the default ones: a bias that they share with the pose is invisible in their own agreement.
    """
    if recipe.witness == "none":
        return {}
    image, cloud = _pair("--witness", recipe.witness or Recipe().extractor)
    names = {WITNESS[0]: (Kind.IMAGE_EXTRACTOR, image), WITNESS[1]: (Kind.CLOUD_EXTRACTOR, cloud)}
    extractors = _installed(recipe, names, registry, required=recipe.witness is not None)
    if not extractors:
        return {}
    packages = {part.offer.dist for part in extractors.values()}
    own = checks_itself(parts) and packages.issuperset(parts[stage].offer.dist for stage in EXTRACTORS)
    if own and recipe.witness is None:
        return {}
    beside = {"data": parts["data"].offer} if "data" in parts else {}
    offers = {**beside, "extractor": extractors["witness"].offer, "cloud": extractors["witness-cloud"].offer}
    if recipe.witness is not None:
        check_fit(offers, registry)
    if misfit_of(offers) is not None:
        return {}
    return extractors | _witness_stages(recipe, extractors, offers, registry)


def _witness_stages(
    recipe: Recipe, witness: Mapping[str, Part], offers: Mapping[str, Offer], registry: Registry
) -> dict[str, Part]:
    """Return the other stages of the independent check; none if its edges have no sides."""
    if not all("side" in part.offer.method.gives for part in witness.values()):
        return {}
    names = {of: (KIND_OF[stage], Recipe.model_fields[stage].default) for stage, of in WITNESS_STAGES.items()}
    parts = _installed(recipe, names, registry)
    beside = {stage: parts[of].offer for stage, of in WITNESS_STAGES.items() if parts}
    return parts if misfit_of({**offers, **beside}) is None else {}


@dataclass(frozen=True)
class Plan:
    """A resolved recipe: every method found, every option validated, every stage fitting the next.

    `initial_guess` is that of the recipe's `start`, which is read once.
    """

    recipe: Recipe
    parts: Mapping[str, Part]
    pipeline: Options | None
    registry: Registry
    rig: Rig | None = None
    initial_guess: InitialGuess | None = field(default=None, compare=False)

    def dataset(self) -> GuardedDataset | JoinedFrames:
        """Return the dataset, with accumulated sweeps if the recipe selects them; frames are read on access."""
        dataset: GuardedDataset | JoinedFrames = self.joined(self.parts["data"].build())
        return dataset

    def joined(self, frames: Any) -> Any:
        """Return frames with accumulated sweeps if the recipe selects them, else unchanged."""
        from p2o.run.joined import JoinedFrames

        return JoinedFrames(frames, self.parts["accumulate"].build()) if "accumulate" in self.parts else frames

    def assembly(self) -> Assembly:
        """Return the built methods, ready to calibrate; heavy packages are imported here."""
        from p2o.run.assembly import Assembly

        return Assembly.of(self.parts, self.pipeline)

    def calibrator(self) -> Pipeline | GuardedCalibrator:
        """Return the `Pipeline` of the stages, or the whole method."""
        return self.assembly().calibrator

    def check_frame(self, frame: Frame) -> None:
        """Raise InputError with alternatives if a method needs content that this frame does not have."""
        self.check_contents(frame.name, contents_of(frame))

    def check_contents(self, frame: str, contents: frozenset[str]) -> None:
        """Raise InputError as `check_frame` for the name of a frame with these words for its optional content."""
        # The independent check is no stage of the method: if a frame lacks its inputs, the verdict reports it.
        offers = {stage: part.offer for stage, part in self.parts.items() if stage not in WITNESS}
        # Frames passed in Python have no dataset: substitute one that guarantees no content.
        blank = Method(name="frame", build=dict, summary="Frames of Python.", gives=frozenset({"frames"}))
        offers.setdefault("data", Offer(Kind.DATASET, blank, "", "", ""))
        misfit = misfit_of(offers, contents)
        if misfit is not None:
            word, _, user = misfit
            hint = suggest_alternative(offers, self.registry, user, contents)
            raise InputError(f"the frame has no {word}; {user.name} needs it", where=frame, hint=hint)

    def described(self) -> dict[str, Any]:
        """Return the recipe with every option that took effect, ready for JSON; `Recipe.of(**it)` repeats the run."""
        unused = set(STAGED_WORDS) if self.recipe.calibrator is not None else {"calibrator"}
        words = {k: v for k, v in self.recipe.model_dump(mode="json", exclude=unused).items() if k not in _SELDOM or v}
        # The stages of the independent check and the wide search follow from the recipe: they have no options.
        own = {stage: part for stage, part in self.parts.items() if stage not in (WIDE, *WITNESS_STAGES.values())}
        words["options"] = {stage: part.options.model_dump(mode="json") for stage, part in own.items()}
        if self.pipeline is not None:
            words["options"]["pipeline"] = self.pipeline.model_dump(mode="json")
        return words

    def licences(self) -> dict[str, str]:
        """Return the licences of the data files (weights) of the methods, by stage."""
        licences: dict[str, str] = {}
        for stage, part in self.parts.items():
            if part.offer.method.data_licence is not None:
                with watch(part.offer, "naming the licence of its data files"):
                    licences[stage] = str(part.offer.method.data_licence(part.options))
        return {stage: text for stage, text in licences.items() if text}

    def versions(self) -> dict[str, str]:
        """Return the versions of all packages that contribute to the result."""
        import platform
        from importlib.metadata import PackageNotFoundError, version

        out = {"python": platform.python_version()}
        solvers, networks = ("pycolmap", "pyceres"), ("torch", "onnxruntime")
        for name in ("p2o-calib", "numpy", "scipy", "opencv-contrib-python-headless", *solvers, *networks):
            try:
                out[name] = version(name)
            except PackageNotFoundError:
                continue
        out.update({part.offer.dist: part.offer.version for part in self.parts.values() if part.offer.version})
        return out


def checks_itself(parts: Mapping[str, Part]) -> bool:
    """Return whether the edges of a pipeline check its results: those of both sensors, matched by their directions."""
    gives = {word for stage in EXTRACTORS if stage in parts for word in parts[stage].offer.method.gives}
    return {"image-edges", "cloud-edges"} <= gives and "side" in parts["matcher"].offer.method.needs


def open_dataset(data: str, registry: Registry, options: Mapping[str, Any] | None = None) -> GuardedDataset:
    """Return the dataset of a text DATASET:PATH; its frames are read on access. Raises as `Recipe.resolve`."""
    dataset: GuardedDataset = dataset_part(data, registry, options).build()
    return dataset


def dataset_part(data: str, registry: Registry, options: Mapping[str, Any] | None = None, seed: int = 0) -> Part:
    """Return the method and the validated options of a text DATASET:PATH; nothing is opened.

    Raises as `Recipe.resolve`.
    """
    name, values = split_data(data, registry)
    try:
        offer = registry.find(Kind.DATASET, name)
    except UnknownNameError as problem:
        # A text of one word may be the mistyped name of a folder.
        if name == data and nearest(Path(name)):
            raise no_such_folder(Path(name), "DATASET:PATH, or an existing path") from problem
        raise
    return part_of(offer, "data", {**values, **(options or {})}, seed)


def open_exporter(text: str, registry: Registry) -> tuple[Exporter, Path]:
    """Return the exporter of a text NAME:PATH (or NAME:PATH?field=value), and the path.

    Raises UnknownNameError for an unknown exporter, InputError where the path is missing or an option is bad.
    """
    name, values = split_name(text)
    path = values.pop("root", None)
    if path is None:
        raise InputError("an export needs a path", where="--export", expected="NAME:PATH, such as json:result.json")
    exporter: Exporter = part_of(registry.find(Kind.EXPORTER, name), "export", values, seed=0).build()
    return exporter, Path(path)
