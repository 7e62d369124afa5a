"""Reads calibration files with the readers of a registry: FILE, FILE#NAME, FILE?FIELD=VALUE&...

Without a registry the functions take `Registry.of_process()`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qsl

from p2o.arrays import Float
from p2o.calibration_files.calibration import Calibration, Source
from p2o.errors import InputError, MethodUnavailable, PluginError
from p2o.files.input_file import expanded
from p2o.geometry.camera import Camera
from p2o.geometry.rough_start import is_rough_start, rough_start
from p2o.host.guard import GuardedReader, build
from p2o.host.method import Kind
from p2o.host.registry import Offer, Registry
from p2o.options import validated

Place = Callable[[str], Path]
"""Returns the path of a file name, e.g. relative to the folder of the file that names it."""

_REFERENCE = re.compile(
    r"(?P<file>.*?)(?:#(?P<name>[^#?]{1,200}))?(?:\?(?P<query>[a-z_]+=[^&]*(?:&[a-z_]+=[^&]*)*))?", re.DOTALL
)


def read_calibration_file(
    path: Path, form: str | None = None, options: Mapping[str, Any] | None = None, registry: Registry | None = None
) -> Calibration:
    """Return the content of a calibration file, read by the reader `form` or else by the first that recognises it.

    `options` are those of the reader, such as the fields of `Reading`. Raises InputError for a file that cannot be
    read, that no reader recognises, or that holds neither a valid camera nor a valid transform, UnknownNameError for an
    unknown reader or option, and PluginError for a faulty reader.
    """
    registry = Registry.of_process() if registry is None else registry
    source = Source.of(path)
    offer = recognised(source, registry) if form is None else registry.find(Kind.CALIBRATION_READER, form)
    calibration = _built(offer, options, path).read(source)
    if calibration.lacks_image_size:
        remark = f"{path}: the camera is left out, because the file does not state the image size (?width=W&height=H)"
        calibration = replace(calibration, remarks=(remark, *calibration.remarks))
    if not calibration.parts:
        text = f"this {offer.name} file holds neither a camera nor an extrinsic"
        raise InputError(text, where=path, got=calibration.remarks[0] if calibration.remarks else None)
    return calibration


def recognised(source: Source, registry: Registry) -> Offer:
    """Return the reader of lowest rank (then first name) that recognises a file; raises InputError if none does."""
    readers: list[tuple[int, Offer, GuardedReader]] = []
    unavailable: list[str] = []
    for offer in registry.of_kind(Kind.CALIBRATION_READER):
        try:
            reader = _built(offer)
        except MethodUnavailable as problem:
            unavailable.append(str(problem))
            continue
        readers.append((reader.rank, offer, reader))
    readers.sort(key=lambda entry: entry[0])
    for _, offer, reader in readers:
        if reader.recognises(source):
            return offer
    text = "no calibration reader recognises this file"
    expected = ", ".join(offer.name for _, offer, _ in readers) or "an installed plugin that reads calibration files"
    got = None if source.problem is None else f"{source.problem.what} ({source.problem.got})"
    if not source.text:
        got = "bytes that are not UTF-8 text"
    raise InputError(text, where=source.path, expected=expected, got=got, hint="; ".join(unavailable) or None)


def _built(offer: Offer, options: Mapping[str, Any] | None = None, where: Path | None = None) -> GuardedReader:
    """Return a reader with these options; raises PluginError if options without values have no default."""
    try:
        reader: GuardedReader = build(offer, validated(offer.method.options, options or {}, "reading", where=where))
    except InputError as problem:
        if options:
            raise
        raise PluginError(f"plugin {offer.dist}: {offer.kind} '{offer.name}': {problem}") from problem
    return reader


def read_calibration(
    reference: str,
    where: object = None,
    place: Place = expanded,
    form: str | None = None,
    registry: Registry | None = None,
) -> Calibration:
    """Return the content of FILE, FILE#NAME or FILE?FIELD=VALUE&...; raises as `read_calibration_file`.

    NAME is one of several cameras of a file, a FIELD is an option of the reader, or `form`, the name of the reader.
    """
    if not isinstance(reference, str) or not reference.strip():
        raise InputError("the calibration file has no name", where=where, expected="FILE", got=repr(reference)[:60])
    match = _REFERENCE.fullmatch(reference.strip())
    assert match is not None  # the first group matches any text
    fields: dict[str, Any] = {"name": match["name"]} if match["name"] else {}
    for key, value in parse_qsl(match["query"] or "", keep_blank_values=True):
        if key in fields:
            raise InputError(f"{key} is given twice", where=where, expected="each field once", got=reference)
        fields[key] = value
    stated_form = fields.pop("form", None)
    return read_calibration_file(place(match["file"]), form or stated_form, fields, registry)


def read_camera_file(
    reference: str, where: object = None, place: Place = expanded, registry: Registry | None = None
) -> Camera:
    """Return the camera of a calibration file; raises as `read_calibration`, and InputError if it holds no camera."""
    return read_calibration(reference, where, place, registry=registry).intrinsics(reference)


def read_extrinsic_file(
    reference: str, where: object = None, place: Place = expanded, registry: Registry | None = None
) -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of a calibration file, and warnings.

    Raises as `read_calibration`, and InputError if the file holds no extrinsic.
    """
    calibration = read_calibration(reference, where, place, registry=registry)
    return calibration.extrinsic(reference), calibration.remarks


class InitialGuess(NamedTuple):
    """An initial camera_from_lidar (4, 4), remarks on it, and whether its rotation was given as a quaternion."""

    camera_from_lidar: Float
    remarks: tuple[str, ...] = ()
    quaternion: bool = False

    @classmethod
    def read(
        cls, text: str, where: object = "start", place: Place = expanded, registry: Registry | None = None
    ) -> InitialGuess:
        """Return the initial guess of a description ("roughly x forward, ...") or a calibration file.

        Raises InputError as `rough_start` or `read_extrinsic_file`.
        """
        if not names_file(text):
            return cls(rough_start(text, where))
        calibration = read_calibration(text, where, place, registry=registry)
        return cls(calibration.extrinsic(text), calibration.remarks, calibration.quaternion)


def read_initial_guess(
    text: str, where: object = "start", place: Place = expanded, registry: Registry | None = None
) -> tuple[Float, tuple[str, ...]]:
    """Return the initial camera_from_lidar (4, 4) of a text and remarks, as `InitialGuess.read`."""
    return InitialGuess.read(text, where, place, registry)[:2]


def names_file(text: str) -> bool:
    """Return whether the text of a start names a file: it has a suffix and is no description ("roughly ...")."""
    match = _REFERENCE.fullmatch(text.strip())
    return match is not None and not is_rough_start(text) and bool(re.search(r"\.\w{1,8}$", match["file"]))
