"""Study files: a TOML file that says which methods to compare on which frames, from which starts, beside which figures.

Reading one does no work: every word is looked up, every option validated and every combination fitted together
first. docs/studies.md explains each key.
"""

from __future__ import annotations

import importlib.resources
import itertools
import math
import re
import string
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date, time
from importlib.metadata import entry_points
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, StrictBool, StringConstraints, ValidationError

from p2o.errors import InputError, P2OError, UnknownNameError, printable
from p2o.files.input_file import existing_folder, expanded, read_text
from p2o.files.parsed_text import parse_toml
from p2o.geometry.perturb import Perturbation, parse_perturbation
from p2o.geometry.start_list import parse_starts
from p2o.host.registry import GROUP, Registry
from p2o.host.slots import METHOD_WORDS, SLOTS, STAGED_WORDS, STAGES
from p2o.host.validation import fault_of
from p2o.run.recipe import Plan, Recipe
from p2o.run.run import starts_of
from p2o.run.words import data_by_name

FOLDER = "studies"
"""Folder of a package that ships studies: PACKAGE/studies/NAME.toml."""

ALL_JOINT = -1
"""Number of frames that are solved together where it is all of them."""
BY_CAMERA = -2
"""Number of frames that are solved together where it is all of one camera and rig."""

MOST_SEEDS = 10_000
"""So many starts a row; more would tell nothing that these do not."""
LARGEST_SEED = 2**32 - 1
MOST_ROWS = 20_000
"""So many rows of a table times seeds, unless more are meant: each takes milliseconds to be looked up, and a file of a
few lines may ask for more than anyone can wait for."""


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
    Annotated[int, Field(strict=True, ge=1, le=MOST_SEEDS)] | Annotated[tuple[Seed, ...], Field(max_length=MOST_SEEDS)]
)
Joint = StrictBool | Annotated[int, Field(strict=True, ge=2)] | Literal["camera"]
Metric = Literal["rotation_deg", "translation_m", "roll_deg", "pitch_deg", "yaw_deg", "x_m", "y_m", "z_m"]
Options = dict[str, dict[str, Any]]

# Each may be the name of a variant that sets it. Extractors are named IMAGE/CLOUD, as no variant can be.
PLAIN = ("accumulate", "witness", "perturb")
"""Words that no variant stands for."""

_KIND_OF_WORD = {slot.word: slot.kind for slot in SLOTS if slot.word in METHOD_WORDS and not slot.sensor}


def limits_of(text: str, where: str) -> Perturbation:
    """Return an angle and a length such as "0.5deg 0.15m"; raises InputError, naming `where`, for any other text."""
    limits = parse_perturbation(text, where)
    if limits.in_camera or not limits.exact:
        raise InputError("cannot read the size", where=where, expected='text such as "0.5deg 0.15m"', got=repr(text))
    return limits


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Words(_Table):
    """Words of a recipe; what is left out is said elsewhere, or takes the default of `Recipe`."""

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
    """Words and options under a name, which stands in the place of a method or in a row's `use`."""

    name: Slug


class DatasetTable(_Table):
    """Frames to run on: `data` is DATASET:PATH as in `p2o run`, or DATASET: where the path comes from --data.

    `path` is where they are below the folder of --root. `split` names their lists in a file of splits, for
    `--frames @FILE`. One that is `optional` is left out where nothing says where its frames are.
    """

    name: Slug
    data: str
    frames: str = "all"
    path: str = ""
    split: tuple[str, ...] = ()
    optional: bool = False
    options: dict[str, Any] = Field(default_factory=dict)

    @property
    def left_out(self) -> bool:
        """True where the rows of this dataset are left out, as nothing says where its frames are."""
        return self.optional and not self.data.partition(":")[2]

    def below(self, root: Path) -> DatasetTable:
        """Return the dataset with its `path` below a folder, where it has one, says no other, and is there."""
        at = root / self.path
        if not self.path or self.data.partition(":")[2] or not at.is_dir():
            return self
        return self.model_copy(update={"data": f"{self.data.partition(':')[0]}:{at}"})

    def chosen(self, spec: str) -> DatasetTable:
        """Return the dataset with other frames; of a file of splits that names none, those that `split` says."""
        if self.split and spec.startswith("@") and not set("#,") & set(spec):
            spec = ",".join(f"{spec}#{split}" for split in self.split)
        return self.model_copy(update={"frames": spec})


class _Scope(_Table):
    """What a row or product may say about itself besides its words."""

    section: Line = ""
    dataset: tuple[Slug, ...] | None = None
    joint: Joint | None = None
    seeds: Seeds | None = None


class RowTable(Words, _Scope):
    """One row of the table: its label, the variants that it uses, and further words."""

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
    """Figures of a publication beside ours; `beside` is the label of the row they compare with."""

    label: Label
    source: Label
    values: dict[Metric, float]
    beside: Label | None = None
    start: Line = ""
    note: str = ""


class Study(_Table):
    """A whole study file.

    `defaults` are words of every row that does not say otherwise. `perturb`, `joint` and `seeds` hold for all rows
    that do not say their own: a perturbation as in `p2o run`, or a `protocol` that draws starts and whose figures are
    told below the table; False (each frame alone), True (all frames together), "camera" (all of one camera together)
    or a number N (groups of N successive frames together, the last of which may be smaller); a number of seeds, 0 to
    N - 1, or a list. `metrics` are the columns of the tables; with `within`, a size such as "0.5deg 0.15m", they count
    who ended so near to the truth, and who ended farther from it than the start.
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

    @property
    def limits(self) -> Perturbation | None:
        """What `within` says; raises InputError where it cannot be read."""
        return None if self.within is None else limits_of(self.within, f"study {self.name}, within")

    def overridden(
        self,
        data: Sequence[str] = (),
        frames: str | Sequence[str] | None = None,
        seeds: int | Sequence[int] | None = None,
        root: str | Path | None = None,
    ) -> Study:
        """Return the study on other data, frames or seeds, as the command line says them.

        `data` are texts DATASET:PATH (a study of one dataset) or NAME=DATASET:PATH, `root` the folder that holds those
        of the others where the study says it. `frames` are for all datasets, or NAME=SPEC for one. `seeds` replaces
        those of single rows too. Raises UnknownNameError for a dataset that the study does not name, InputError where
        it is not said which of several is meant, or `root` is no folder.
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

    def rows(self, at_most: int = MOST_ROWS) -> list[StudyRow]:
        """Return every row of the table, in the order of the file: products first, then explicit rows.

        Raises InputError for clashing names and words, and for more than `at_most` rows times seeds; UnknownNameError
        for variants and datasets that are not there.
        """
        return list(_Expansion(self, at_most).rows())


@dataclass(frozen=True, eq=False)
class StudyRow:
    """One row of a study's table on one dataset, ready to be resolved.

    `said` holds the words as the file says them (names of variants stay), `words` those of the recipe without data,
    frames, seed and joint. `joint` is the number of frames to solve together: 0 each alone, ALL_JOINT all, BY_CAMERA
    all of one camera.
    """

    label: str
    section: str
    dataset: DatasetTable
    said: Mapping[str, str]
    words: Mapping[str, Any]
    seeds: tuple[int, ...]
    joint: int
    where: str

    def recipe(self, seed: int) -> Recipe:
        """Return the recipe of one seed; the dataset's own seed stays that of the file."""
        options = {**self.words.get("options", {})}
        data = {**self.dataset.options, **options.get("data", {})}
        if data:
            options["data"] = data
        words = {**self.words, "options": options, "data": self.dataset.data, "frames": self.dataset.frames}
        return Recipe.of(**words, seed=seed, joint=self.joint == ALL_JOINT)

    def resolve(self, registry: Registry, seed: int) -> Plan:
        """Return the plan of one seed; what is wrong with it names the row.

        Raises as `Recipe.resolve`.
        """
        try:
            return self.recipe(seed).resolve(registry)
        except P2OError as problem:
            raise retold(problem, f"{self.where}, row '{self.label}'") from problem


def retold(problem: P2OError, where: str, hint: str | None = None) -> P2OError:
    """Return an error with the place in the study that it comes from, and a hint where it has none."""
    kind = InputError if isinstance(problem, UnknownNameError) else type(problem)
    what = problem.what if problem.where is None else f"{problem.where}: {problem.what}"
    return kind(what, where=where, expected=problem.expected, got=problem.got, hint=problem.hint or hint)


class _Expansion:
    """Turns the tables of a study into rows."""

    def __init__(self, study: Study, at_most: int) -> None:
        self.study, self.at_most = study, at_most
        self.where = f"study {study.name}"
        self.variants = {variant.name: variant for variant in study.variant}
        self._refuse_twice("variant", [variant.name for variant in study.variant])
        self._refuse_twice("dataset", [table.name for table in study.dataset])
        for variant in study.variant:
            for word in METHOD_WORDS:
                if getattr(variant, word) in self.variants:
                    self._fail(
                        f"variant '{variant.name}' is made of the variant '{getattr(variant, word)}'",
                        "names of methods",
                    )

    def rows(self) -> Iterator[StudyRow]:
        self._refuse_too_many()
        found: list[StudyRow] = []
        for product in self.study.product:
            for words, use, label in self._combinations(product):
                found += self._row(label, words, use, product)
        for row in self.study.row:
            words = {word: getattr(row, word) for word in (*METHOD_WORDS, *PLAIN) if getattr(row, word) is not None}
            found += self._row(row.label, words, row.use, row, row.options)
        if not found:
            self._fail("there are no rows", "[[row]] or [[product]] tables")
        self._refuse_twice("row", [row.label for row in found])
        self._refuse_twice("published row", [published.label for published in self.study.published])
        labels = {row.label for row in found} | {row.label.rpartition(" @ ")[0] for row in found}
        for published in self.study.published:
            if published.beside is not None and published.beside not in labels:
                raise UnknownNameError("row", published.beside, labels - {""}, where=f"{self.where}, published rows")
        given = [row for row in found if not row.dataset.left_out]
        if not given:
            raise InputError(
                "no data are given",
                where=self.where,
                expected="--root DIR or --data NAME=DATASET:PATH with a NAME of "
                + ", ".join(dict.fromkeys(row.dataset.name for row in found)),
            )
        yield from given

    def _refuse_too_many(self) -> None:
        """Raise InputError where there are more rows than anyone can wait for; none of them is made for that."""
        count = 0
        for scope in (*self.study.product, *self.study.row):
            seeds = self.study.seeds if scope.seeds is None else scope.seeds
            combined = 1
            if isinstance(scope, Product):
                combined = math.prod(len(values) for values in _axes(scope).values()) * max(1, len(scope.use))
            datasets = len(self.study.dataset if scope.dataset is None else scope.dataset)
            count += combined * datasets * (seeds if isinstance(seeds, int) else len(seeds))
        if count > self.at_most:
            raise InputError(
                f"the study asks for {count:.6g} rows times seeds",
                where=self.where,
                expected=f"at most {self.at_most}",
                hint="ask for fewer, or say that so many are meant: --at-most N",
            )

    def _combinations(self, product: Product) -> Iterator[tuple[dict[str, str], tuple[str, ...], str]]:
        """Return words, variants and label of each combination."""
        axes = _axes(product)
        uses = product.use or ((),)
        if not axes and not product.use:
            self._fail("a product has nothing to combine", ", ".join(METHOD_WORDS))
        for name, values in (*axes.items(), ("use", [" ".join(use) for use in product.use])):
            self._refuse_twice(f"{name} of a product", values)
        varying = [word for word, values in axes.items() if len(values) > 1] or list(axes)
        pattern = product.label or " ".join(
            f"{{{w}}}" for w in [*varying, *(["use"] if len(uses) > 1 or not varying else [])]
        )
        for chosen, use in itertools.product(itertools.product(*axes.values()), uses):
            words = dict(zip(axes, chosen, strict=True))
            label = _filled(pattern, {**words, "use": " ".join(use)})
            if label is None:
                names = " ".join(f"{{{w}}}" for w in (*axes, "use"))
                self._fail(f"the label '{pattern}' of a product cannot be filled in", f"names such as {names}")
            else:
                yield words, use, label

    def _row(
        self, label: str, words: Mapping[str, str], use: Sequence[str], scope: _Scope, options: Options | None = None
    ) -> list[StudyRow]:
        """Return the row on each dataset that it is for."""
        said = dict(words)
        sources: list[tuple[str, Words]] = []
        for name in use:
            if name not in self.variants:
                raise UnknownNameError("variant", name, self.variants, where=f"{self.where}, row '{label}'")
            sources.append((f"variant '{name}'", self.variants[name]))
            said.update(
                {w: name for w in METHOD_WORDS if getattr(self.variants[name], w) is not None and w not in said}
            )
        plain: dict[str, Any] = {}
        for word, value in words.items():
            variant = self.variants.get(value)
            if variant is None or word in PLAIN:
                plain[word] = value
            elif getattr(variant, word) is None:
                self._fail(f"row '{label}': variant '{value}' sets no {word}", f"a {word}")
            else:
                sources.append((f"variant '{value}'", variant))
        sources.append((f"row '{label}'", Words(**plain, options=options or {})))
        merged = self._merged(label, sources)
        datasets = self._datasets(label, scope)
        seeds = self.study.seeds if scope.seeds is None else scope.seeds
        joint = self.study.joint if scope.joint is None else scope.joint
        for word in ("calibrator",) if "calibrator" in merged else STAGED_WORDS:
            said.setdefault(word, merged.get(word, Recipe.model_fields[word].default))
        return [
            StudyRow(
                label=label if len(self.study.dataset) == 1 else f"{label} @ {table.name}",
                section=scope.section,
                dataset=table,
                said={word: value for word, value in said.items() if word in METHOD_WORDS},
                words=merged,
                seeds=tuple(range(seeds)) if isinstance(seeds, int) else self._distinct(label, seeds),
                joint=_frames_of(joint),
                where=self.where,
            )
            for table in datasets
        ]

    def _merged(self, label: str, sources: Sequence[tuple[str, Words]]) -> dict[str, Any]:
        """Return the words of all sources, which may not contradict each other, over the defaults of the study."""
        said: dict[tuple[str, ...], Any] = {}
        giver: dict[tuple[str, ...], str] = {}
        for source, words in sources:
            for key, value in _flat(words):
                if key in said and said[key] != value:
                    self._fail(f"row '{label}': {giver[key]} and {source} both set {'.'.join(key[-2:])}", "one of them")
                said[key], giver[key] = value, source
        staged = any((word,) in said for word in STAGED_WORDS)
        whole = ("calibrator",) in said or (self.study.defaults.calibrator is not None and not staged)
        defaults = {key: value for key, value in _flat(self.study.defaults) if _applies(key, whole)}
        methods = [_methods({key[0]: words[key] for key in words if len(key) == 1}) for words in (defaults, said)]
        for key, value in defaults.items():
            # The options of a default are for that method, not for another one in its place.
            replaced = len(key) == 3 and key[1] in methods[1] and methods[0].get(key[1]) != methods[1][key[1]]
            if not replaced:
                said.setdefault(key, value)
        start = starts_of(self.study.protocol, self.study.perturb, f"{self.where}, protocol")
        if start is not None:
            said.setdefault(("perturb",), start)
        merged: dict[str, Any] = {"options": {}}
        for key, value in said.items():
            if len(key) == 1:
                merged[key[0]] = value
            else:
                merged["options"].setdefault(key[1], {})[key[2]] = value
        return merged

    def _datasets(self, label: str, scope: _Scope) -> list[DatasetTable]:
        tables = {table.name: table for table in self.study.dataset}
        if scope.dataset is None:
            return list(tables.values())
        for name in scope.dataset:
            if name not in tables:
                raise UnknownNameError("dataset", name, tables, where=f"{self.where}, row '{label}'")
        return [tables[name] for name in dict.fromkeys(scope.dataset)]

    def _distinct(self, label: str, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(seeds)) < len(seeds) or not seeds:
            self._fail(f"row '{label}' has seeds {list(seeds)}", "different seeds, at least one")
        return seeds

    def _refuse_twice(self, kind: str, names: Sequence[str]) -> None:
        twice = next((name for name, count in Counter(names).items() if count > 1), None)
        if twice is not None:
            self._fail(f"two of the kind {kind} are called '{twice}'", "a name of its own for each")

    def _fail(self, what: str, expected: str) -> None:
        raise InputError(what, where=self.where, expected=expected)


def _frames_of(joint: bool | int | str) -> int:
    """Return how many frames are solved together, as `StudyRow.joint` has it."""
    if isinstance(joint, bool):
        return ALL_JOINT if joint else 0
    return BY_CAMERA if isinstance(joint, str) else joint


def _axes(product: Product) -> dict[str, tuple[str, ...]]:
    """Return the lists that a product combines, by word, `use` left out."""
    return {word: getattr(product, word) for word in (*METHOD_WORDS, *PLAIN) if getattr(product, word)}


def _filled(pattern: str, words: Mapping[str, str]) -> str | None:
    """Return a label whose {names} are filled in; None for names that are not there and for anything but a name.

    Python's own formats reach into objects ("{x.__class__}") and make texts as wide as they are told ("{x:>9999999}").
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


def check_study(study: Study, registry: Registry, at_most: int = MOST_ROWS) -> list[StudyRow]:
    """Return the rows of a study after resolving each with its first seed's recipe; no data are read.

    Raises a P2OError that names the row: unknown names, bad options, stages that do not fit (with what would), a
    variant called like a method, a perturbation that cannot be read; and as `Study.rows` does.
    """
    for variant in study.variant:
        for word, kind in _KIND_OF_WORD.items():
            if getattr(variant, word) is not None and any(o.name == variant.name for o in registry.of_kind(kind)):
                raise InputError(
                    f"variant '{variant.name}' is called like a {kind.value} that is installed",
                    where=f"study {study.name}",
                    expected="a name of its own",
                )
        for stage in variant.options:
            if stage not in STAGES:
                raise UnknownNameError("stage", stage, STAGES, where=f"study {study.name}, variant '{variant.name}'")
        if variant.perturb is not None:
            parse_starts(variant.perturb)
    _ = study.limits
    rows = study.rows(at_most)
    for row in rows:
        row.resolve(registry, row.seeds[0])
    return rows


def _flat(words: Words) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Return what is said by key: ("matcher",) for a word, ("options", "matcher", "sides") for an option."""
    for word in (*METHOD_WORDS, *PLAIN):
        if getattr(words, word) is not None:
            yield (word,), getattr(words, word)
    for stage, values in words.options.items():
        yield from ((("options", stage, field), value) for field, value in values.items())


def _applies(key: tuple[str, ...], whole: bool) -> bool:
    """True where a default is of use beside a whole method (`whole`), or beside stages."""
    name = key[-2] if len(key) == 3 else key[0]
    if name in (*PLAIN, "data", "witness-cloud"):
        return True
    return (name == "calibrator") == whole


def _methods(words: Mapping[str, str]) -> dict[str, str]:
    """Return the method of each stage that the words choose."""
    image, _, cloud = words.get("extractor", "").partition("/")
    chosen = {**words, "extractor": image, "cloud": cloud}
    return {stage: name for stage, name in chosen.items() if name}


@dataclass(frozen=True)
class StudyFile:
    """A study with the text it was read from; `source` names its place."""

    study: Study
    text: str
    source: str


def find_study(word: str, registry: Registry) -> StudyFile:
    """Return the study of a path, or of a name among those that the loaded plugins ship.

    A plugin ships studies in the folder `studies` of its package; NAME@DISTRIBUTION decides between two of a name.
    A word that ends in .toml or holds a slash is a path.

    Raises UnknownNameError for an unknown name, InputError for a file that cannot be read or two of one name, and as
    `parse_study`.
    """
    path = expanded(word)
    if word.endswith(".toml") or "/" in word or "\\" in word:
        if not path.exists():
            raise InputError("there is no such study file", where=word, expected="a TOML file, or the name of a study")
        return _read(path, str(path))
    name, at, dist = word.partition("@")
    shipped = shipped_studies(registry)
    found = [(owner, file) for owner, file in shipped.get(name, []) if not at or owner == dist]
    if not found:
        raise UnknownNameError("study", word, shipped, hint="or give the path of a TOML file")
    if len(found) > 1:
        raise InputError(
            f"study '{name}' is shipped by several: {' and '.join(owner for owner, _ in found)}",
            hint="write " + " or ".join(f"{name}@{owner}" for owner, _ in found),
        )
    return _read(found[0][1], str(found[0][1]))


def shipped_studies(registry: Registry) -> dict[str, list[tuple[str, Traversable]]]:
    """Return the files of studies by name, each with the distribution that ships it; no plugin needs a hook for it."""
    loaded = {(plugin.dist, plugin.entry) for plugin in registry.plugins}
    packages: dict[str, str] = {}
    for entry in entry_points(group=GROUP):
        dist = "" if entry.dist is None else re.sub(r"[-_.]+", "-", entry.dist.name).lower()
        if (dist, entry.name) in loaded:
            packages.setdefault(entry.module.partition(".")[0], dist)
    found: dict[str, list[tuple[str, Traversable]]] = {}
    for package, dist in sorted(packages.items()):
        try:
            folder = importlib.resources.files(package).joinpath(FOLDER)
            files = sorted(folder.iterdir(), key=lambda file: file.name) if folder.is_dir() else []
        except (ImportError, OSError, TypeError):  # a plugin that is one module has no folder
            continue
        for file in files:
            if file.name.endswith(".toml"):
                found.setdefault(file.name.removesuffix(".toml"), []).append((dist, file))
    return dict(sorted(found.items()))


def _read(file: Traversable | Path, source: str) -> StudyFile:
    if isinstance(file, Path):
        text = read_text(file, "study file")
    else:
        try:
            text = file.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as problem:
            raise InputError("the study file cannot be read", where=source, got=problem) from problem
    return StudyFile(parse_study(text, source), text, source)


def parse_study(text: str, source: str = "study") -> Study:
    """Return the study of a TOML text.

    Raises InputError for text that is not TOML and for values that do not fit, UnknownNameError for an unknown key
    with the nearest ones; both name the place.
    """
    content = parse_toml(text, "study", source)
    _refuse_odd_values(content, source)
    try:
        return Study.model_validate(content)
    except ValidationError as problem:
        raise _explained(problem, content, source) from problem


def _refuse_odd_values(value: Any, source: str, path: tuple[str, ...] = ()) -> None:
    """Raise InputError for values of TOML that no word and no option takes, and that JSON has no form for."""
    if isinstance(value, dict | list):
        inner = value.items() if isinstance(value, dict) else enumerate(value, start=1)
        for key, part in inner:
            _refuse_odd_values(part, source, (*path, str(key)))
        return
    where, expected = f"{source}, {'.'.join(path)}", ""
    if isinstance(value, date | time):
        value, expected = value.isoformat(), "a text in quotes, a number, a switch or a list"
    elif isinstance(value, float) and not math.isfinite(value):
        expected = "a finite number"
    elif isinstance(value, int) and abs(value) >= 2**63:
        value, expected = "more", "a whole number of 64 bits"
    if expected:
        raise InputError("this value is of no use in a study", where=where, expected=expected, got=value)


def _explained(problem: ValidationError, content: Mapping[str, Any], source: str) -> InputError:
    """Return the first fault in words: which table, which key, what was expected, what it is."""
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
