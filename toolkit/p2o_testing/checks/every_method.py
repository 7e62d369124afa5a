"""What every method promises, whatever its slot."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from p2o.geometry.perturb import parse_perturbation
from p2o.host.method import Kind
from p2o.run.recipe import dataset_part

from p2o_testing.subject import CheckFailed, Checks, Subject, frames_of, lacking, require

CHECKS = Checks(*Kind)
OF_FRAMES = Checks(Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR, Kind.CALIBRATOR, Kind.ACCUMULATOR)


@CHECKS.of()
def every_option_has_a_default(subject: Subject) -> None:
    """Every option has a default that is within its own bounds; only a dataset's `root` may be required."""
    model = subject.offer.method.options
    required = [name for name, field in model.model_fields.items() if field.is_required()]
    allowed = ["root"] if subject.offer.kind == Kind.DATASET else []
    require(set(required) <= set(allowed), f"options without default: {', '.join(required)}")
    if not required:
        model()


@CHECKS.of()
def every_option_is_described(subject: Subject) -> None:
    """Every option has a one-sentence description."""
    bare = [n for n, f in subject.offer.method.options.model_fields.items() if not (f.description or "").strip()]
    require(not bare, f"options without help: {', '.join(bare)}")


@CHECKS.of()
def options_survive_json(subject: Subject) -> None:
    """Options written to JSON and read back are equal."""
    again = type(subject.options).model_validate(json.loads(subject.options.model_dump_json()))
    require(again == subject.options, f"{subject.options!r} became {again!r}")


@CHECKS.of()
def builds_twice_offline(subject: Subject) -> None:
    """Building works twice in a row and opens no connection."""
    with _offline():
        subject.built()
        subject.built()


@CHECKS.of(lambda method: method.example is not None)
def the_example_needs_no_files(subject: Subject) -> None:
    """The example names a dataset that makes its frames itself, a start and an accuracy that can be read."""
    assert subject.example is not None
    part = dataset_part(subject.example.data, subject.registry)
    require("root" not in part.offer.method.options.model_fields, f"{part.offer.name} reads files")
    parse_perturbation(subject.example.perturb, "Example.perturb")
    parse_perturbation(subject.example.within, "Example.within")


@OF_FRAMES.of()
def there_are_frames_to_check_it_on(subject: Subject) -> None:
    """The stage holds what the method needs of a frame, or an example names frames that do."""
    missing = lacking(subject.needs, subject.once(frames_of))
    require(not missing, f"the frames have no {' and no '.join(missing)}: name others in Method.example")


@contextmanager
def _offline() -> Iterator[None]:
    """Make every connection an error."""

    def refuse(*_: Any) -> None:
        raise CheckFailed("building opens a connection")

    kept = socket.socket.connect
    socket.socket.connect = refuse  # type: ignore[method-assign]
    try:
        yield
    finally:
        socket.socket.connect = kept  # type: ignore[method-assign]
