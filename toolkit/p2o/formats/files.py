"""Every form of calibration file, and one way to read any of them: FILE, FILE#NAME, FILE?FIELD=VALUE."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from p2o.arrays import Float
from p2o.errors import InputError, UnknownNameError
from p2o.files.input_file import expanded
from p2o.formats.calibration import Calibration
from p2o.formats.format import Format, Reading
from p2o.formats.source import Source
from p2o.geometry.camera import Camera
from p2o.geometry.rough_start import rough_start
from p2o.host.validation import validated

_FORM = re.compile(
    r"(?P<file>.*?)(?:#(?P<name>[^#?]{1,200}))?(?:\?(?P<query>[a-z_]+=[^&]*(?:&[a-z_]+=[^&]*)*))?", re.DOTALL
)


@cache
def formats() -> Mapping[str, Format]:
    """Return all forms by name, in the order in which a file is tried for them: the surest signs first."""
    from p2o.formats import (
        autoware,
        camera_info,
        colmap,
        kalibr,
        kitti_text,
        koide,
        matrix_file,
        opencalib,
        opencv_yaml,
        plain_text,
        result_file,
        ros_transform,
    )

    known = (
        matrix_file.NPY_FORMAT,
        ros_transform.FORMAT,
        opencv_yaml.FORMAT,
        result_file.FORMAT,
        koide.FORMAT,
        opencalib.FORMAT,
        opencalib.CAMERA_FORMAT,
        colmap.FORMAT,
        colmap.CAMERAS_FORMAT,
        camera_info.FORMAT,
        kalibr.FORMAT,
        autoware.FORMAT,
        kitti_text.FORMAT,
        plain_text.FORMAT,
        matrix_file.TEXT_FORMAT,
    )
    return {form.name: form for form in known}


def format_named(name: str, where: object = None) -> Format:
    """Return the form of a name; raises UnknownNameError for any other."""
    if name not in formats():
        raise UnknownNameError("form of calibration file", name, formats(), where=where)
    return formats()[name]


def format_of(source: Source) -> Format:
    """Return the form that the content of a file has; raises InputError where it has none of them."""
    for form in formats().values():
        if form.recognises(source):
            return form
    raise InputError(
        "this is no calibration file that p2o knows",
        where=source.path,
        expected=", ".join(formats()),
        got=None if source.problem is None else f"{source.problem.what} ({source.problem.got})",
    )


def read_file(path: Path, form: str | None = None, **reading: Any) -> Calibration:
    """Return what a calibration file holds; its content says which form it has, unless `form` does.

    `reading` are fields of `Reading`: which of several cameras, which frames, the size of the image.

    Raises InputError for a file that cannot be read, has no known form, or holds what is no camera or no transform.
    """
    known = validated(Reading, reading, "reading", where=path)
    source = Source.of(path)
    chosen = format_of(source) if form is None else format_named(form)
    try:
        found = chosen.read(source, known)
    except RecursionError as problem:
        raise InputError("the calibration file nests too deeply", where=path) from problem
    if not found.held:
        raise InputError(
            f"this {chosen.name} file holds neither a camera nor an extrinsic",
            where=path,
            got=found.remarks[0] if found.remarks else None,
        )
    return found


def read_words(
    text: str, where: object = None, place: Callable[[str], Path] = expanded, form: str | None = None
) -> Calibration:
    """Return what FILE, FILE#NAME or FILE?FIELD=VALUE&... holds, as `read_file`; `place` makes a path of the file.

    NAME is a camera of several, fields are those of `Reading` and `form`.
    """
    if not isinstance(text, str) or not text.strip():
        raise InputError("the calibration file has no name", where=where, expected="FILE", got=repr(text)[:60])
    match = _FORM.fullmatch(text.strip())
    assert match is not None  # the first group takes anything
    fields: dict[str, Any] = {"name": match["name"]} if match["name"] else {}
    for key, value in parse_qsl(match["query"] or "", keep_blank_values=True):
        if key in fields:
            raise InputError(f"{key} is said twice", where=where, expected="each once", got=text)
        fields[key] = value
    said = fields.pop("form", None)
    return read_file(place(match["file"]), form or said, **fields)


def camera_words(text: str, where: object = None, place: Callable[[str], Path] = expanded) -> Camera:
    """Return the camera of a file; raises InputError as `read_words`, and for a file without one."""
    found = read_words(text, where, place)
    if found.camera is None and found.remarks:
        raise InputError(
            "there is no camera in it",
            where=text,
            expected="intrinsics and the size of the image",
            hint="say the size: FILE?width=W&height=H",
        )
    return found.intrinsics(text)


def extrinsic_words(
    text: str, where: object = None, place: Callable[[str], Path] = expanded
) -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of a file and remarks; raises InputError as `read_words`, and without one."""
    found = read_words(text, where, place)
    return found.extrinsic(text), found.remarks


def start_words(
    text: str, where: object = "start", place: Callable[[str], Path] = expanded
) -> tuple[Float, tuple[str, ...]]:
    """Return camera_from_lidar (4, 4) of a text, and remarks: words ("roughly x forward, ...") or a calibration file.

    Raises InputError as `rough_start` or `extrinsic_words`.
    """
    if names_file(text):
        return extrinsic_words(text, where, place)
    return rough_start(text, where), ()


def names_file(text: str) -> bool:
    """Return whether a start names a file: it has a suffix, and does not begin with "roughly"."""
    match = _FORM.fullmatch(text.strip())
    head = text.lower().split(maxsplit=1)[:1]
    return match is not None and head != ["roughly"] and bool(re.search(r"\.\w{1,8}$", match["file"]))


def joined(extrinsic: Calibration, camera: Calibration, where: object = None) -> Calibration:
    """Return the extrinsic of one calibration with the camera of another; raises InputError where it has none."""
    return replace(extrinsic, camera=camera.intrinsics(where), remarks=(*extrinsic.remarks, *camera.remarks))
