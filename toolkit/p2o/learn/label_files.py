"""Label files of frames: what a method learns from, made once and found again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.file_names import distinct_names
from p2o.files.input_file import expanded
from p2o.files.whole_file import write_whole
from p2o.frames.selection import select
from p2o.host.guard import GuardedDataset, trainer_of
from p2o.host.registry import Offer, Registry
from p2o.host.trainer import Trainer
from p2o.run.recipe import Part, dataset_part
from p2o.run.words import NamedData


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

    `version` tells apart what labels depend on: the method, its version of labels, the dataset with all its options.
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
    found = [offer for offer in named if offer.method.trainer is not None]
    if not found:
        learners = sorted(offer.name for offer in registry.offers if offer.method.trainer is not None)
        raise InputError(
            f"{named[0].kind} '{named[0].name}' cannot be trained",
            expected=f"one of: {', '.join(learners) or '(no installed method learns)'}",
        )
    if len(found) > 1:
        names = " or ".join(offer.full_name for offer in found)
        raise InputError(f"two methods called '{name}' can be trained", hint=f"write {names}")
    return found[0]


def sources_of(offer: Offer, data: Sequence[str], frames: Sequence[str], registry: Registry) -> list[Source]:
    """Open datasets for a method; nothing of a frame is read.

    `data` are texts [NAME=]DATASET:PATH; `frames` choose of them: none (all), one for all data, or one for each.
    Raises InputError for another number of them or names that occur twice, else as `open_dataset` and `select`.
    """
    if not data:
        raise InputError("there are no frames to learn from", where="--data", expected="DATASET:PATH")
    if len(frames) not in (0, 1, len(data)):
        raise InputError(
            "frames do not fit the data",
            where="--frames",
            expected=f"none, one for all, or one for each --data ({len(data)})",
            got=len(frames),
        )
    specs = list(frames) * len(data) if len(frames) == 1 else list(frames) or ["all"] * len(data)
    trainer = trainer_of(offer)
    sources: list[Source] = []
    for text, spec in zip(data, specs, strict=True):
        said = NamedData.of(text)
        part = dataset_part(said.data, registry)
        taken = [source.name for source in sources]
        name = said.name or _free(part.offer.name, taken)
        if name in taken:
            raise InputError("two data of one name", where="--data", expected="names of their own", got=name)
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

    Files that are there are kept; FOLDER changes with what labels depend on. With `draw`, a picture goes beside each.
    Raises InputError for a frame that teaches nothing, one that cannot be read, and where nothing can be written.
    """
    total, done = sum(len(source.chosen) for source in sources), 0
    written = []
    for source in sources:
        folder = out / source.folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as problem:
            raise InputError(
                "labels cannot be written here", where=folder, got=problem.strerror, hint="choose another --out"
            ) from problem
        write_whole(folder / "labels.json", (json.dumps(source.version, indent=1) + "\n").encode())
        paths = [folder / name for name in source.files(trainer)]
        for index, path in zip(source.chosen, paths, strict=True):
            fresh = _write(trainer, source, index, path, draw)
            done += 1
            on_progress(LabelProgress(done, total, source.dataset.names[index], fresh))
        written.append(paths)
    return written


def _write(trainer: Trainer, source: Source, index: int, path: Path, draw: bool) -> bool:
    """Write one label file, and its picture if wanted; return whether the label is new."""
    fresh = not path.exists()
    if fresh:
        write_whole(path, trainer.label(source.dataset[index]))
    picture = path.with_suffix(".png")
    if draw and (fresh or not picture.exists()):
        from p2o.draw.overlay import write_png

        write_png(picture, trainer.draw(path))
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
    return {
        "method": offer.full_name,
        "label_version": trainer.label_version,
        "data": part.offer.name,
        "reader": f"{part.offer.dist} {part.offer.version}".strip(),
        "options": options,
    }
