"""Study files: TOML files that define methods, frames, initial guesses and published figures to compare.

A study is validated completely before any work: names, options and the compatibility of stages. docs/studies.md
explains each key.
"""

from __future__ import annotations

import itertools
import math
import string
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NoReturn, Self

from p2o.errors import InputError, P2OError, UnknownNameError, printable
from p2o.files.input_file import existing_folder, expanded, read_text
from p2o.files.parsed_text import parse_toml
from p2o.geometry.perturb import Perturbation, parse_perturbation
from p2o.geometry.start_list import parse_starts
from p2o.host.registry import Registry
from p2o.host.shipped import shipped_files
from p2o.host.slots import METHOD_WORDS, SLOTS, STAGED_WORDS, STAGES
from p2o.options import fault_of
from p2o.run.initial_guess import starts_of
from p2o.run.presets import preset_of
from p2o.run.recipe import Plan, Recipe
from p2o.run.words import data_by_name
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StrictBool, StringConstraints, ValidationError

from p2o_study.damage import STAGE as DAMAGE
from p2o_study.damage import Damage, split_options

FOLDER = "studies"
"""Folder of studies in a package: PACKAGE/studies/NAME.toml."""

ALL_JOINT = -1
"""Number of frames per joint calibration: all."""
BY_CAMERA = -2
"""Number of frames per joint calibration: all frames of one camera and rig."""
BY_RIG = -3
"""Number of frames per joint calibration: all frames of all cameras of a rig, whose transforms are known."""

MAX_SEEDS = 10_000
"""Maximum number of initial guesses per row; more do not improve the statistics."""
LARGEST_SEED = 2**32 - 1
MAX_ROWS = 20_000
"""Maximum number of rows times seeds without confirmation (--at-most): validation takes milliseconds for each, and a
file of a few lines may define billions."""


def _shown_as_it_is(text: str) -> str:
    if printable(text) != text:
        raise ValueError("one line without control characters")
    return text


Line = Annotated[str, StringConstraints(max_length=500), AfterValidator(_shown_as_it_is)]
Slug = Annotated[str, StringConstraints(pattern=r"^[a-z0-9]+([-_.][a-z0-9]+)*$", max_length=100)]
Label = Annotated[
    str, StringConstraints(strip_whitespace=True, min_length=1, max_length=120), AfterValidator(_shown_as_it_is)
]
Seed = Annotated[int, Field(strict=True, ge=0, le=LARGEST_SEED)]
Seeds = (
    Annotated[int, Field(strict=True, ge=1, le=MAX_SEEDS)] | Annotated[tuple[Seed, ...], Field(max_length=MAX_SEEDS)]
)
Joint = StrictBool | Annotated[int, Field(strict=True, ge=2)] | Literal["camera", "rig"]


Metric = Literal["rotation_deg", "translation_m", "roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m"]
if TYPE_CHECKING:
    MetricName = str  # a key of mappings, which are indexed by any text
else:
    MetricName = Metric
Options = dict[str, dict[str, Any]]

PLAIN = ("accumulate", "witness", "perturb")
"""Words whose value cannot be the name of a variant."""

_KIND_OF_WORD = {slot.word: slot.kind for slot in SLOTS if slot.word in METHOD_WORDS and not slot.sensor}


def limits_of(text: str, where: str) -> Perturbation:
    """Parse an angle and a length such as "0.5deg 0.15m"; raises InputError, with `where`, for any other text."""
    limits = parse_perturbation(text, where)
    if limits.in_camera or not limits.exact:
        raise InputError("cannot read the size", where=where, expected='text such as "0.5deg 0.15m"', got=repr(text))
    return limits


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Words(_Table):
    """Words of a recipe; missing ones are set by other tables or take the default of `Recipe`.

    `method` names a published method (`p2o methods --published`, methods.toml), which sets all words and options that
    are not set beside it.
    """

    method: str | None = None
    extractor: str | None = None
    matcher: str | None = None
    solver: str | None = None
    init: str | None = None
    calibrator: str | None = None
    accumulate: str | None = None
    witness: str | None = None
    perturb: str | None = None
    options: Options = Field(default_factory=dict)


class Variant(Words):
    """Named words and options; the name is used in place of a method or in `use` of a row."""

    name: Slug


class DatasetTable(_Table):
    """A dataset: `data` is DATASET:PATH as in `p2o run`, or DATASET: with the path from --data or --root.

    `path` is the path relative to the folder of --root. `split` names the lists of frames in a file of splits, for
    `--frames @FILE`. An `optional` dataset is left out if its path is not given. `development` states that choices of
    p2o were made on its frames, which tables say.
    """

    name: Slug
    data: str
    frames: str = "all"
    path: str = ""
    split: tuple[str, ...] = ()
    optional: bool = False
    development: bool = False
    options: dict[str, Any] = Field(default_factory=dict)

    @property
    def left_out(self) -> bool:
        """True if the dataset is optional and has no path: its rows are left out."""
        return self.optional and not self.data.partition(":")[2]

    def below(self, root: Path) -> DatasetTable:
        """Return the dataset with the path `root`/`path` if that folder exists and no other path is given."""
        at = root / self.path
        if not self.path or self.data.partition(":")[2] or not at.is_dir():
            return self
        return self.model_copy(update={"data": f"{self.data.partition(':')[0]}:{at}"})

    def chosen(self, spec: str) -> DatasetTable:
        """Return the dataset with other frames; a file of splits without names selects the lists in `split`."""
        if self.split and spec.startswith("@") and not set("#,") & set(spec):
            spec = ",".join(f"{spec}#{split}" for split in self.split)
        return self.model_copy(update={"frames": spec})


class _Scope(_Table):
    """Keys of a row or product that are not words of a recipe."""

    section: Line = ""
    dataset: tuple[Slug, ...] | None = None
    joint: Joint | None = None
    seeds: Seeds | None = None


class RowTable(Words, _Scope):
    """One row of the table: label, variants and words."""

    label: Label
    use: tuple[Slug, ...] = ()


class Product(_Scope):
    """Every combination of the lists; `label` is a pattern such as "{matcher} {solver}"."""

    label: Label | None = None
    use: tuple[tuple[Slug, ...], ...] = ()
    extractor: tuple[str, ...] = ()
    matcher: tuple[str, ...] = ()
    solver: tuple[str, ...] = ()
    init: tuple[str, ...] = ()
    calibrator: tuple[str, ...] = ()
    accumulate: tuple[str, ...] = ()
    witness: tuple[str, ...] = ()
    perturb: tuple[str, ...] = ()


class Published(_Table):
    """Figures of a publication as printed, in degrees and metres; `beside` is the label of the row to compare with.

    `figure` states which statistic they are, such as "median", `frames` of what, `training` on what the method was
    trained, `start` its initial error, and `section` the table of a page.
    """

    label: Label
    source: Label
    values: dict[MetricName, float]
    beside: Label | None = None
    section: Line = ""
    training: Line = ""
    start: Line = ""
    frames: Line = ""
    figure: Line = ""
    note: str = ""

    def compares_with(self, label: str) -> bool:
        """Return whether it compares with the row of a label, or with "LABEL @ DATASET" of several datasets."""
        return bool(self.beside) and self.beside in (label, label.rpartition(" @ ")[0])


class Study(_Table):
    """The content of a study file.

    `defaults` are the words of rows that do not set them; `perturb`, `joint` and `seeds` are defaults, too. `perturb`
    is a perturbation as in `p2o run`; instead, a `protocol` draws the initial guesses, and its figures are printed
    below the table. `joint` is False (each frame alone), True (joint calibration of all frames), "camera" (joint
    calibration of all frames of one camera), "rig" (one calibration of the edges of all cameras, with the transforms
    between them from the ground truth) or a number N (groups of N successive frames; the last may be smaller).
    `seeds` is a number N of seeds, 0 to N - 1, or a list. `metrics` are the columns of the tables. With `within`, a
    size such as "0.5deg 0.15m", tables count calibrations within these errors, and those with a larger error than the
    initial guess.
    """

    name: Slug
    title: Label
    note: str = ""
    dataset: tuple[DatasetTable, ...] = Field(min_length=1)
    defaults: Words = Words()
    variant: tuple[Variant, ...] = ()
    product: tuple[Product, ...] = ()
    row: tuple[RowTable, ...] = ()
    published: tuple[Published, ...] = Field(default=(), max_length=1000)
    perturb: str | None = None
    protocol: str | None = None
    within: str | None = None
    joint: Joint = False
    seeds: Seeds = 1
    metrics: tuple[Metric, ...] = Field(default=("rotation_deg", "translation_m"), min_length=1, max_length=8)

    def with_methods(self, registry: Registry) -> Self:
        """Return the study with words and options of published methods in place of their names.

        Raises UnknownNameError for an unknown method.
        """

        def with_method(table: Words, place: str) -> Words:
            if table.method is None:
                return table
            options = {"options": table.options} if table.options else {}
            preset = preset_of(table.method, registry, f"study {self.name}, {place}")
            return table.model_copy(update={**preset.merged({**_words_of(table), **options}), "method": None})

        variants = tuple(with_method(table, "[[variant]]") for table in self.variant)
        rows = tuple(with_method(table, "[[row]]") for table in self.row)
        return self.model_copy(
            update={"variant": variants, "row": rows, "defaults": with_method(self.defaults, "[defaults]")}
        )

    @property
    def limits(self) -> Perturbation | None:
        """The parsed `within`; raises InputError if it is invalid."""
        return None if self.within is None else limits_of(self.within, f"study {self.name}, within")

    def overridden(
        self,
        data: Sequence[str] = (),
        frames: str | Sequence[str] | None = None,
        seeds: int | Sequence[int] | None = None,
        root: str | Path | None = None,
    ) -> Self:
        """Return the study with other data, frames or seeds, in the form of the command line.

        `data` are texts DATASET:PATH (a study of one dataset) or NAME=DATASET:PATH, `root` the folder with the `path`
        of all other datasets. `frames` apply to all datasets, or to one (NAME=SPEC). `seeds` also replaces those of
        single rows. Raises UnknownNameError for an unknown dataset, InputError if NAME is missing but needed, or `root`
        is no folder.
        """
        tables = {table.name: table for table in self.dataset}
        for name, value in data_by_name(data, tables, f"study {self.name}").items():
            tables[name] = tables[name].model_copy(update={"data": value})
        if root is not None:
            folder = existing_folder(Path(root), "the data of studies")
            tables = {name: table.below(folder) for name, table in tables.items()}
        for spec in () if frames is None else (frames,) if isinstance(frames, str) else frames:
            name, equals, rest = spec.partition("=")
            one = bool(equals) and name in tables
            for key in (name,) if one else tuple(tables):
                tables[key] = tables[key].chosen(rest if one else spec)
        changes: dict[str, Any] = {"dataset": tuple(tables.values())}
        if seeds is not None:
            own = {"seeds": seeds if isinstance(seeds, int) else tuple(seeds)}
            changes |= own
            changes["row"] = tuple(row.model_copy(update=own) for row in self.row)
            changes["product"] = tuple(product.model_copy(update=own) for product in self.product)
        return self.model_copy(update=changes)

    def rows(self, at_most: int = MAX_ROWS) -> list[StudyRow]:
        """Return the rows of the table: products first, then explicit rows, in the order of the file.

        Raises InputError for clashing names and words and for more than `at_most` rows times seeds, UnknownNameError
        for unknown variants and datasets.
        """
        self._check_names()
        self._refuse_too_many(at_most)
        tables = [*(row for product in self.product for row in self._combinations(product)), *self.row]
        rows = [row for table in tables for row in self._expanded(table)]
        if not rows:
            self._fail("the study has no rows", "[[row]] or [[product]] tables")
        self._refuse_twice("row", [row.label for row in rows])
        labels = {row.label for row in rows} | {row.label.rpartition(" @ ")[0] for row in rows}
        for published in self.published:
            if published.beside is not None and published.beside not in labels:
                where = f"study {self.name}, published rows"
                raise UnknownNameError("row", published.beside, labels - {""}, where=where)
        given = [row for row in rows if not row.dataset.left_out]
        if not given:
            names = ", ".join(dict.fromkeys(row.dataset.name for row in rows))
            self._fail("no data are given", f"--root DIR or --data NAME=DATASET:PATH with a NAME of {names}")
        return given

    def _fail(self, what: str, expected: str) -> NoReturn:
        raise InputError(what, where=f"study {self.name}", expected=expected)

    def _refuse_twice(self, kind: str, names: Sequence[str]) -> None:
        twice = next((name for name, count in Counter(names).items() if count > 1), None)
        if twice is not None:
            self._fail(f"the name '{twice}' of a {kind} is used twice", "unique names")

    def _check_names(self) -> None:
        variants = [variant.name for variant in self.variant]
        self._refuse_twice("variant", variants)
        self._refuse_twice("dataset", [table.name for table in self.dataset])
        self._refuse_twice("published row", [published.label for published in self.published])
        for variant in self.variant:
            for word in METHOD_WORDS:
                if (other := getattr(variant, word)) in variants:
                    self._fail(f"variant '{variant.name}' uses the variant '{other}'", "names of methods")

    def _refuse_too_many(self, at_most: int) -> None:
        """Raise InputError for too many rows times seeds, without expanding them."""
        count = 0
        for scope in (*self.product, *self.row):
            seeds = self.seeds if scope.seeds is None else scope.seeds
            combined = 1
            if isinstance(scope, Product):
                combined = math.prod(map(len, _words_of(scope).values())) * max(1, len(scope.use))
            datasets = len(self.dataset if scope.dataset is None else scope.dataset)
            count += combined * datasets * (seeds if isinstance(seeds, int) else len(seeds))
        if count > at_most:
            text, expected = f"the study asks for {count:.6g} rows times seeds", f"at most {at_most}"
            hint = "reduce rows or seeds, or confirm the number: --at-most N"
            raise InputError(text, where=f"study {self.name}", expected=expected, hint=hint)

    def _combinations(self, product: Product) -> Iterator[RowTable]:
        """Yield the row of each combination."""
        axes, uses = _words_of(product), product.use or ((),)
        if not axes and not product.use:
            self._fail("a product has no lists to combine", ", ".join(METHOD_WORDS))
        for name, values in (*axes.items(), ("use", [" ".join(use) for use in product.use])):
            self._refuse_twice(f"{name} of a product", values)
        varying = [word for word, values in axes.items() if len(values) > 1] or list(axes)
        named = [*varying, *(["use"] if len(uses) > 1 or not varying else [])]
        pattern = product.label or " ".join(f"{{{word}}}" for word in named)
        scope = {name: getattr(product, name) for name in _Scope.model_fields}
        for chosen, use in itertools.product(itertools.product(*axes.values()), uses):
            words = dict(zip(axes, chosen, strict=True))
            label = _filled(pattern, {**words, "use": " ".join(use)})
            if label is None:
                names = " ".join(f"{{{w}}}" for w in (*axes, "use"))
                self._fail(f"the label '{pattern}' of a product cannot be filled in", f"names such as {names}")
            yield RowTable.model_construct(label=label, use=use, **words, **scope)

    def _expanded(self, row: RowTable) -> list[StudyRow]:
        """Return a row once for each of its datasets."""
        label, where = row.label, f"study {self.name}, row '{row.label}'"
        variants, tables = {one.name: one for one in self.variant}, {table.name: table for table in self.dataset}
        known: Mapping[str, Any]
        for kind, names, known in (("variant", row.use, variants), ("dataset", row.dataset or (), tables)):
            if unknown := [name for name in names if name not in known]:
                raise UnknownNameError(kind, unknown[0], known, where=where)
        sources: list[tuple[str, Words]] = [(f"variant '{name}'", variants[name]) for name in row.use]
        plain: dict[str, Any] = {}
        for word, value in _words_of(row).items():
            variant = None if word in PLAIN else variants.get(value)
            if variant is None:
                plain[word] = value
            elif getattr(variant, word) is None:
                self._fail(f"row '{label}': variant '{value}' sets no {word}", f"a {word}")
            else:
                sources.append((f"variant '{value}'", variant))
        merged = self._merged(label, [*sources, (f"row '{label}'", Words(**plain, options=row.options))])
        seeds = self.seeds if row.seeds is None else row.seeds
        seeds = tuple(range(seeds)) if isinstance(seeds, int) else seeds
        if len(set(seeds)) < len(seeds) or not seeds:
            self._fail(f"row '{label}' has seeds {list(seeds)}", "different seeds, at least one")
        joint = self.joint if row.joint is None else row.joint
        frames = {False: 0, True: ALL_JOINT, "camera": BY_CAMERA, "rig": BY_RIG}.get(joint, joint)
        return [
            StudyRow(
                label if len(tables) == 1 else f"{label} @ {name}",
                row.section,
                tables[name],
                merged,
                seeds,
                int(frames),
                f"study {self.name}",
            )
            for name in dict.fromkeys(tables if row.dataset is None else row.dataset)
        ]

    def _merged(self, label: str, sources: Sequence[tuple[str, Words]]) -> dict[str, Any]:
        """Merge the words of all sources, which may not contradict each other, with the defaults of the study."""
        values: dict[tuple[str, ...], Any] = {}
        giver: dict[tuple[str, ...], str] = {}
        for source, words in sources:
            for key, value in _flat(words):
                if key in values and values[key] != value:
                    self._fail(f"row '{label}': {giver[key]} and {source} both set {'.'.join(key[-2:])}", "one of them")
                values[key], giver[key] = value, source
        staged = any((word,) in values for word in STAGED_WORDS)
        whole = ("calibrator",) in values or (self.defaults.calibrator is not None and not staged)
        defaults = {key: value for key, value in _flat(self.defaults) if _applies(key, whole)}
        by_default, own = _methods(defaults), _methods(values)
        for key, value in defaults.items():
            # Options of the default method do not apply to a method that replaces it.
            if not (len(key) == 3 and key[1] in own and by_default.get(key[1]) != own[key[1]]):
                values.setdefault(key, value)
        start = starts_of(self.protocol, self.perturb, f"study {self.name}, protocol")
        if start is not None:
            values.setdefault(("perturb",), start)
        merged: dict[str, Any] = {"options": {}}
        for key, value in values.items():
            if len(key) == 1:
                merged[key[0]] = value
            else:
                merged["options"].setdefault(key[1], {})[key[2]] = value
        return merged


@dataclass(frozen=True, eq=False)
class StudyRow:
    """One row of a study's table on one dataset.

    `words` are those of the recipe without data, frames, seed and joint. `joint` is the number of frames per joint
    calibration: 0 each alone, ALL_JOINT all, BY_CAMERA all of one camera, BY_RIG all of all cameras of a rig.
    """

    label: str
    section: str
    dataset: DatasetTable
    words: Mapping[str, Any]
    seeds: tuple[int, ...]
    joint: int
    where: str

    def recipe(self, seed: int) -> Recipe:
        """Return the recipe of one seed; the seed of the dataset is that of the file."""
        options, _ = split_options(self.words.get("options", {}), seed)
        data = {**self.dataset.options, **options.get("data", {})}
        if data:
            options["data"] = data
        words = {**self.words, "options": options, "data": self.dataset.data, "frames": self.dataset.frames}
        rig = {"rig": True} if self.joint == BY_RIG else {}
        return Recipe.of(**words, **rig, seed=seed, joint=self.joint == ALL_JOINT)

    def damage(self, seed: int) -> Damage:
        """Return the damage to the features of frames for one seed."""
        return split_options(self.words.get("options", {}), seed)[1]

    def resolve(self, registry: Registry, seed: int) -> Plan:
        """Return the plan of one seed; raises as `Recipe.resolve`, with the place of the row."""
        try:
            return self.recipe(seed).resolve(registry)
        except P2OError as problem:
            raise with_place(problem, f"{self.where}, row '{self.label}'") from problem


def with_place(problem: P2OError, where: str, hint: str | None = None) -> P2OError:
    """Return an error with its place in the study, and with `hint` if it has none."""
    kind = InputError if isinstance(problem, UnknownNameError) else type(problem)
    what = problem.what if problem.where is None else f"{problem.where}: {problem.what}"
    return kind(what, where=where, expected=problem.expected, got=problem.got, hint=problem.hint or hint)


def _words_of(table: Words | Product) -> dict[str, Any]:
    """Return the words that a table sets; of a product, the lists that it combines, without `use`."""
    return {word: value for word in (*METHOD_WORDS, *PLAIN) if (value := getattr(table, word)) not in (None, ())}


def _filled(pattern: str, words: Mapping[str, str]) -> str | None:
    """Fill in the {names} of a label; return None for unknown names and anything but names.

    `str.format` is not used: it accesses attributes ("{x.__class__}") and accepts any width ("{x:>9999999}").
    """
    try:
        pieces = list(string.Formatter().parse(pattern))
    except ValueError:
        return None
    filled = []
    for text, name, spec, conversion in pieces:
        if name is not None and (name not in words or spec or conversion):
            return None
        filled += [text, "" if name is None else words[name]]
    return "".join(filled).strip()


def check_study(study: Study, registry: Registry, at_most: int = MAX_ROWS) -> list[StudyRow]:
    """Return the rows of a study after resolving each with its first seed; no data are read.

    Raises a P2OError that names the row for unknown names, invalid options, incompatible stages (with compatible
    ones), a variant with the name of a method and an invalid perturbation; and as `Study.rows`.
    """
    study = study.with_methods(registry)
    for variant in study.variant:
        for word, kind in _KIND_OF_WORD.items():
            if getattr(variant, word) is not None and any(o.name == variant.name for o in registry.of_kind(kind)):
                raise InputError(
                    f"variant '{variant.name}' has the name of an installed {kind.value}",
                    where=f"study {study.name}",
                    expected="another name",
                )
        stages = (*STAGES, DAMAGE)
        for stage in variant.options:
            if stage not in stages:
                raise UnknownNameError("stage", stage, stages, where=f"study {study.name}, variant '{variant.name}'")
        if variant.perturb is not None:
            parse_starts(variant.perturb)
    _ = study.limits
    rows = study.rows(at_most)
    for row in rows:
        row.resolve(registry, row.seeds[0])
        if row.joint == BY_RIG and row.damage(row.seeds[0]).missing_edges:
            where = f"{row.where}, row '{row.label}'"
            raise InputError("damage of the features of a rig", where=where, expected='no joint = "rig" beside it')
    return rows


def _flat(words: Words) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield (key, value): the key is ("matcher",) for a word, ("options", "matcher", "sides") for an option."""
    yield from (((word,), value) for word, value in _words_of(words).items())
    for stage, values in words.options.items():
        yield from ((("options", stage, field), value) for field, value in values.items())


def _applies(key: tuple[str, ...], whole: bool) -> bool:
    """Return whether a default applies to a row with a calibrator (`whole`) or with stages."""
    name = key[-2] if len(key) == 3 else key[0]
    if name in (*PLAIN, "data", "witness-cloud"):
        return True
    return (name == "calibrator") == whole


def _methods(values: Mapping[tuple[str, ...], Any]) -> dict[str, str]:
    """Return the method of each stage that words, in the form of `_flat`, select."""
    words = {key[0]: value for key, value in values.items() if len(key) == 1}
    image, _, cloud = words.get("extractor", "").partition("/")
    return {stage: name for stage, name in {**words, "extractor": image, "cloud": cloud}.items() if name}


def find_study(word: str, registry: Registry) -> Study:
    """Return the study of a path, or of the name of a study that a loaded plugin ships in its folder `studies`.

    Raises UnknownNameError for an unknown name, InputError for a file that cannot be read, and as `parse_study`.
    """
    path = named_file(word, shipped_toml(registry, FOLDER), "study")
    return parse_study(read_text(path, "study file"), str(path)).with_methods(registry)


def shipped_toml(registry: Registry, folder: str) -> dict[str, Path]:
    """Return the TOML files in `folder` of the packages of loaded plugins by name, sorted.

    Files of several distributions with one name are NAME@DISTRIBUTION.
    """
    files = [(Path(str(file)), dist) for dist, file in shipped_files(registry, folder) if file.name.endswith(".toml")]
    counts = Counter(path.stem for path, _ in files)
    return {
        p.stem if counts[p.stem] == 1 else f"{p.stem}@{dist}": p for p, dist in sorted(files, key=lambda f: f[0].stem)
    }


def named_file(word: str, known: Mapping[str, Path], kind: str, folder: str | Path | None = None) -> Path:
    """Return the known file of a name, or the path of a TOML file: a word that ends in .toml or contains a slash.

    Raises UnknownNameError for an unknown name.
    """
    if word.endswith(".toml") or "/" in word or "\\" in word:
        return expanded(word)
    if word not in known:
        raise UnknownNameError(kind, word, known, where=folder, hint="or give the path of a TOML file")
    return known[word]


def parse_study(text: str, source: str = "study") -> Study:
    """Parse a study from TOML; raises InputError for text that is not TOML, and as `study_of`."""
    return study_of(parse_toml(text, "study", source), source)


def study_of(content: Any, source: str) -> Study:
    """Return the study of the content of a study file.

    Raises InputError for invalid values, UnknownNameError for an unknown key, both with the place.
    """
    _refuse_unsupported_values(content, source)
    try:
        return Study.model_validate(content)
    except ValidationError as problem:
        raise _explained(problem, content, source) from problem


def _refuse_unsupported_values(value: Any, source: str, path: tuple[str, ...] = ()) -> None:
    """Raise InputError for TOML values that no word or option accepts and that JSON cannot represent."""
    if isinstance(value, dict | list):
        inner = value.items() if isinstance(value, dict) else enumerate(value, start=1)
        for key, part in inner:
            _refuse_unsupported_values(part, source, (*path, str(key)))
        return
    where, expected = f"{source}, {'.'.join(path)}", ""
    if isinstance(value, date | time):
        value, expected = value.isoformat(), "a text in quotes, a number, a switch or a list"
    elif isinstance(value, float) and not math.isfinite(value):
        expected = "a finite number"
    elif isinstance(value, int) and abs(value) >= 2**63:
        value, expected = "a larger integer", "an integer of 64 bits"
    if expected:
        raise InputError("a study cannot contain this value", where=where, expected=expected, got=value)


def _explained(problem: ValidationError, content: Mapping[str, Any], source: str) -> InputError:
    """Return the error for the first fault, with table, key, expected and actual value."""
    fault = fault_of(problem, Study, content)
    table, *rest = fault.path
    entry, place = content.get(str(table)), f"[{table}]"
    if rest and isinstance(rest[0], int) and isinstance(entry, list):
        number = rest[0]
        entry, place, rest = entry[number], f"[[{table}]] {number + 1}", rest[1:]
    if not (rest and isinstance(entry, dict)):
        return fault.error(where=source)
    named = entry.get("label") or entry.get("name")
    where = f"{source}, {place}" + (f" '{named}'" if named else "")
    return replace(fault, path=tuple(rest)).error(where=where)
