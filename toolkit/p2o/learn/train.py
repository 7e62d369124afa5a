"""One training: frames in, weights out. `p2o train` comes through here."""

from __future__ import annotations

import hashlib
import json
import shlex
from collections.abc import Callable, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.input_file import read_text
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from p2o.host.guard import trainer_of
from p2o.host.registry import Offer
from p2o.host.slots import SLOT_OF
from p2o.host.trainer import TrainingGroup, TrainingProgress
from p2o.learn.label_files import LabelProgress, Source, write_labels
from p2o.options import Options
from p2o.run.recipe import Recipe


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

    `shares` says by source how much of the training it makes up (empty: all the same); frames whose name fits one of
    the patterns `held_out` are not learnt from but validated on. Labels go to out/labels, then as `Trainer.train` says;
    out/training.json tells what it learnt from. Started again with the same arguments, it goes on.

    Raises InputError for shares that do not fit, patterns that fit no frame, nothing left to learn from, and a folder
    that holds another training; MethodUnavailable where a package is missing.
    """
    if len(shares) not in (0, len(sources)):
        raise InputError(
            "shares do not fit the data",
            where="--share",
            expected=f"none, or one for each --data ({len(sources)})",
            got=len(shares),
        )
    trainer = trainer_of(offer)
    held = [[any(fnmatchcase(frame, p) for p in held_out) for frame in source.frames] for source in sources]
    for pattern in held_out:
        if not any(fnmatchcase(frame, pattern) for source in sources for frame in source.frames):
            raise InputError(
                "no frame is held out",
                where="--validate",
                expected=f"a pattern that fits names such as {sources[0].frames[0]}",
                got=pattern,
            )
    if all(all(mask) for mask in held):
        raise InputError("every frame is held out", where="--validate", expected="some frames to learn from")
    weights_of = list(shares) or [1.0] * len(sources)
    words = _words(offer, sources, weights_of, held_out)
    record = out / "training.json"
    _check_same(record, words)
    files = write_labels(trainer, sources, out / "labels", on_progress=on_label)

    def chosen(number: int, validation: bool) -> list[Path]:
        return [path for path, h in zip(files[number], held[number], strict=True) if h is validation]

    groups = [
        TrainingGroup(source.name, tuple(chosen(number, False)), share)
        for number, (source, share) in enumerate(zip(sources, weights_of, strict=True))
    ]
    validation = [path for number in range(len(sources)) for path in chosen(number, True)]

    def report(progress: TrainingProgress) -> None:
        # Only now is there something in the folder that another training would spoil.
        _write_record(record, {**words, "training": options.model_dump(mode="json")})
        on_progress(progress)

    weights = trainer.train(options, groups, validation, out, report)
    if (out / "log.csv").is_file():
        from p2o.draw.plots import learning_curves

        learning_curves(out / "log.csv", out / "log.png")
    return weights


def usage(offer: Offer, weights_option: str, weights: Path) -> str:
    """Return the command that calibrates with trained weights."""
    image, _, cloud = Recipe().extractor.partition("/")
    slot = SLOT_OF[offer.kind]
    name = slot.said(offer.name, {"extractor": image, "cloud": cloud})
    return f"p2o run {slot.option} {name} --set {shlex.quote(f'{slot.stage}.{weights_option}={weights}')}"


def _words(offer: Offer, sources: Sequence[Source], shares: Sequence[float], held_out: Sequence[str]) -> dict[str, Any]:
    """Return what a training learns from, ready for JSON."""
    data = [
        {
            "name": source.name,
            "share": share,
            "labels": source.folder,
            "frames": len(source.chosen),
            "names": hashlib.sha256("\n".join(source.frames).encode()).hexdigest()[:16],
        }
        for source, share in zip(sources, shares, strict=True)
    ]
    return {"method": offer.full_name, "data": data, "held_out": sorted(held_out)}


def _check_same(record: Path, words: dict[str, Any]) -> None:
    """Raise InputError where the folder was made by a training on something else."""
    if not record.exists():
        return
    said = parse_json(read_text(record, "record of a training"), "record of a training", record)
    if not isinstance(said, dict) or not words.keys() <= said.keys():
        raise InputError("this is no record of a training", where=record, hint="choose another --out")
    kept = {name: said[name] for name in words}
    for name, value in words.items():
        if kept[name] != value:
            raise InputError(
                f"the folder holds another training: its {name.replace('_', ' ')} differ",
                where=record,
                expected=json.dumps(kept[name])[:200],
                got=json.dumps(value)[:200],
                hint="choose another --out, or the same words to go on",
            )


def _write_record(record: Path, words: dict[str, Any]) -> None:
    content = (json.dumps(words, indent=1) + "\n").encode()
    if not record.exists() or record.read_bytes() != content:
        write_whole(record, content)
