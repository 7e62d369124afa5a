"""Label files of frames, made once, and one training from them: frames in, weights out."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.file_names import distinct_names
from p2o.files.input_file import expanded, read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_errors, write_whole
from p2o.frames.selection import select
from p2o.host.guard import GuardedDataset
from p2o.host.method import Trainer, TrainingGroup, TrainingProgress
from p2o.host.registry import Offer, Registry
from p2o.host.slots import SLOT_OF
from p2o.options import Options
from p2o.run.recipe import Part, Recipe, dataset_part
from p2o.run.words import NamedData

from p2o_train.guarded_trainer import trainer_of


@dataclass(frozen=True)
class LabelProgress:
    """How far the labels are: `done` of `total`; `name` is the last frame, `fresh` whether its label is new."""

    done: int
    total: int
    name: str
    fresh: bool


@dataclass(frozen=True, eq=False)
class Source:
    """Frames to learn from: the dataset, which of its frames, and the folder that their labels have.

    `version` holds what labels depend on: the method, its version of labels, the dataset with all its options.
    """

    name: str
    dataset: GuardedDataset
    chosen: tuple[int, ...]
    version: dict[str, Any]

    @property
    def folder(self) -> str:
        """Name of the folder of labels: the dataset's name and a hash of the version."""
        text = json.dumps(self.version, sort_keys=True)
        return f"{self.version['data']}-{hashlib.sha256(text.encode()).hexdigest()[:10]}"

    @property
    def frames(self) -> list[str]:
        """Names of the chosen frames."""
        return [self.dataset.names[index] for index in self.chosen]

    def files(self, trainer: Trainer) -> list[str]:
        """Return the names of the label files, one a chosen frame."""
        return [self._stems[frame] + trainer.suffix for frame in self.frames]

    @cached_property
    def _stems(self) -> dict[str, str]:
        return distinct_names(self.dataset.names)


def trainable(name: str, registry: Registry) -> Offer:
    """Return the one method of this name (or name@distribution) that can be trained.

    Raises UnknownNameError where no method has the name, InputError where none of that name learns, or two do.
    """
    named = registry.named(name)
    trainable_offers = [offer for offer in named if offer.method.trainer is not None]
    if not trainable_offers:
        learners = sorted(offer.name for offer in registry.offers if offer.method.trainer is not None)
        expected = f"one of: {', '.join(learners) or '(no installed method learns)'}"
        raise InputError(f"{named[0].kind} '{named[0].name}' cannot be trained", expected=expected)
    if len(trainable_offers) > 1:
        names = " or ".join(offer.full_name for offer in trainable_offers)
        raise InputError(f"two methods called '{name}' can be trained", hint=f"write {names}")
    return trainable_offers[0]


def sources_of(offer: Offer, data: Sequence[str], frames: Sequence[str], registry: Registry) -> list[Source]:
    """Open datasets for a method; nothing of a frame is read.

    `data` are texts [NAME=]DATASET:PATH; `frames` choose of them: none (all), one for all data, or one for each.
    Raises InputError for another number of them or names that occur twice, else as `open_dataset` and `select`.
    """
    if not data:
        raise InputError("there are no frames to train on", where="--data", expected="DATASET:PATH")
    if len(frames) not in (0, 1, len(data)):
        expected = f"none, one for all, or one for each --data ({len(data)})"
        raise InputError("frames do not fit the data", where="--frames", expected=expected, got=len(frames))
    specs = list(frames) * len(data) if len(frames) == 1 else list(frames) or ["all"] * len(data)
    trainer = trainer_of(offer)
    sources: list[Source] = []
    for text, spec in zip(data, specs, strict=True):
        named = NamedData.of(text)
        part = dataset_part(named.data, registry)
        taken = [source.name for source in sources]
        name = named.name or _free(part.offer.name, taken)
        if name in taken:
            raise InputError("two data sets with the same name", where="--data", expected="distinct names", got=name)
        dataset = part.build()
        chosen = select(dataset.names, spec, where="--frames", skipped=dataset.skipped)
        sources.append(Source(name, dataset, tuple(chosen), _version(offer, trainer, part)))
    return sources


def write_labels(
    trainer: Trainer,
    sources: Sequence[Source],
    out: Path,
    *,
    draw: bool = False,
    on_progress: Callable[[LabelProgress], None] = lambda progress: None,
) -> list[list[Path]]:
    """Write a label file for each frame into out/FOLDER and return their paths, source by source.

    Files that are there are kept; FOLDER changes with what labels depend on. With `draw`, an image goes beside each.
    Raises InputError for a frame that teaches nothing, one that cannot be read, and where nothing can be written.
    """
    total, done = sum(len(source.chosen) for source in sources), 0
    written = []
    for source in sources:
        folder = out / source.folder
        with write_errors("labels", folder, "choose another --out"):
            folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / "labels.json", (json.dumps(source.version, indent=1) + "\n").encode())
        paths = [folder / name for name in source.files(trainer)]
        for index, path in zip(source.chosen, paths, strict=True):
            fresh = _write(trainer, source, index, path, draw)
            done += 1
            on_progress(LabelProgress(done, total, source.dataset.names[index], fresh))
        written.append(paths)
    return written


def _write(trainer: Trainer, source: Source, index: int, path: Path, draw: bool) -> bool:
    """Write one label file, and its image if wanted; return whether the label is new."""
    fresh = not path.exists()
    if fresh:
        write_whole(path, trainer.label(source.dataset[index]))
    image = path.with_suffix(".png")
    if draw and (fresh or not image.exists()):
        from p2o.draw.overlay import write_png

        write_png(image, trainer.draw(path))
    return fresh


def _free(name: str, taken: Sequence[str]) -> str:
    number = 2
    free = name
    while free in taken:
        free, number = f"{name}-{number}", number + 1
    return free


def _version(offer: Offer, trainer: Trainer, part: Part) -> dict[str, Any]:
    options = part.options.model_dump(mode="json")
    if isinstance(options.get("root"), str):
        options["root"] = str(expanded(options["root"]).absolute())
    method = {"method": offer.full_name, "label_version": trainer.label_version}
    reader = f"{part.offer.dist} {part.offer.version}".strip()
    return {**method, "data": part.offer.name, "reader": reader, "options": options}


def train(
    offer: Offer,
    options: Options,
    sources: Sequence[Source],
    shares: Sequence[float],
    held_out: Sequence[str],
    out: Path,
    *,
    on_label: Callable[[LabelProgress], None] = lambda progress: None,
    on_progress: Callable[[TrainingProgress], None] = lambda progress: None,
) -> Path:
    """Train a method on frames, into the folder `out`, and return the file of weights.

    `shares` are the weights of the sources (empty: equal); frames with names that match a pattern of `held_out` are
    used for validation only. Labels are written to out/labels, the provenance to out/training.json. The same call
    resumes an interrupted training. Raises InputError for wrong shares, patterns without a frame, no frames to train
    on, and a folder of another training; MethodUnavailable where a package is missing.
    """
    if len(shares) not in (0, len(sources)):
        expected = f"none, or one for each --data ({len(sources)})"
        raise InputError("shares do not fit the data", where="--share", expected=expected, got=len(shares))
    trainer = trainer_of(offer)
    is_held_out = [[any(fnmatchcase(frame, p) for p in held_out) for frame in source.frames] for source in sources]
    for pattern in held_out:
        if not any(fnmatchcase(frame, pattern) for source in sources for frame in source.frames):
            expected = f"a pattern that matches names such as {sources[0].frames[0]}"
            raise InputError("the pattern matches no frame", where="--validate", expected=expected, got=pattern)
    if all(all(mask) for mask in is_held_out):
        raise InputError("all frames are held out", where="--validate", expected="some frames to train on")
    weights_of = list(shares) or [1.0] * len(sources)
    words = _words(offer, sources, weights_of, held_out)
    record = out / "training.json"
    _check_same(record, words)
    files = write_labels(trainer, sources, out / "labels", on_progress=on_label)

    def chosen(number: int, validation: bool) -> list[Path]:
        return [path for path, h in zip(files[number], is_held_out[number], strict=True) if h is validation]

    groups = [
        TrainingGroup(source.name, tuple(chosen(number, False)), share)
        for number, (source, share) in enumerate(zip(sources, weights_of, strict=True))
    ]
    validation = [path for number in range(len(sources)) for path in chosen(number, True)]

    def report(progress: TrainingProgress) -> None:
        # Only now is there something in the folder that another training would spoil.
        content = (json.dumps({**words, "training": options.model_dump(mode="json")}, indent=1) + "\n").encode()
        if not record.exists() or record.read_bytes() != content:
            write_whole(record, content)
        on_progress(progress)

    weights = trainer.train(options, groups, validation, out, report)
    if (out / "log.csv").is_file():
        from p2o_train.curves import learning_curves

        learning_curves(out / "log.csv", out / "log.png")
    return weights


def usage(offer: Offer, weights_option: str, weights: Path) -> str:
    """Return the command that calibrates with trained weights."""
    image, _, cloud = Recipe().extractor.partition("/")
    slot = SLOT_OF[offer.kind]
    name = slot.spec(offer.name, {"extractor": image, "cloud": cloud})
    return f"p2o run {slot.option} {name} --set {shlex.quote(f'{slot.stage}.{weights_option}={weights}')}"


def _words(offer: Offer, sources: Sequence[Source], shares: Sequence[float], held_out: Sequence[str]) -> dict[str, Any]:
    """Return what a training learns from, ready for JSON."""
    data = []
    for source, share in zip(sources, shares, strict=True):
        names = hashlib.sha256("\n".join(source.frames).encode()).hexdigest()[:16]
        words = {"name": source.name, "share": share, "labels": source.folder}
        data.append({**words, "frames": len(source.chosen), "names": names})
    return {"method": offer.full_name, "data": data, "held_out": sorted(held_out)}


def _check_same(record: Path, words: dict[str, Any]) -> None:
    """Raise InputError where the folder was made by a training on something else."""
    if not record.exists():
        return
    stored = parse_json(read_text(record, "record of a training"), "record of a training", record)
    if not isinstance(stored, dict) or not words.keys() <= stored.keys():
        raise InputError("this is not a record of a training", where=record, hint="choose another --out")
    previous = {name: stored[name] for name in words}
    for name, value in words.items():
        if previous[name] != value:
            text = f"the folder holds another training: its {name.replace('_', ' ')} differ"
            expected, hint = json.dumps(previous[name])[:200], "choose another --out, or the same arguments to resume"
            raise InputError(text, where=record, expected=expected, got=json.dumps(value)[:200], hint=hint)
