"""Whatever text is typed, the words of the command line are understood or refused in one line."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from p2o.errors import P2OError
from p2o.files.file_names import distinct_names
from p2o.files.parsed_text import parse_json, parse_toml, parse_yaml
from p2o.frames.selection import select
from p2o.geometry.perturb import parse_perturbation
from p2o.run.words import parse_fields, parse_settings, split_data, value_of

# Letters that these languages are made of come more often than others.
WORDS = st.one_of(st.text(max_size=60), st.text("0123456789.,:-+eE@#/=?&%[]{}\"'!*<>~ \n\tabcdegmnpx", max_size=60))
_REFUSED = object()


def _read(read: Callable[..., Any], *words: str) -> Any:
    """Return what is read, or a mark where it is refused in one line."""
    try:
        return read(*words)
    except P2OError as problem:
        text = str(problem)
    assert "\n" not in text
    return _REFUSED


NAMES = [f"drive/{i:04d}" for i in range(5)] + ["7", "a b"]


@given(WORDS)
def test_any_choice_of_frames_is_one_of_indices_or_refused(spec: str) -> None:
    chosen = _read(select, NAMES, spec)
    if chosen is _REFUSED:
        return
    assert chosen
    assert len(set(chosen)) == len(chosen)
    assert all(0 <= index < len(NAMES) for index in chosen)


@given(WORDS)
def test_any_perturbation_is_a_finite_size_or_refused(text: str) -> None:
    size = _read(parse_perturbation, text)
    if size is not _REFUSED:
        assert 0 <= size.angle_deg <= 180
        assert 0 <= size.distance_m < math.inf


@pytest.mark.parametrize("read", [split_data, value_of, lambda t: parse_settings([t]), lambda t: parse_fields([t])])
@given(text=WORDS)
def test_any_setting_is_understood_or_refused(read: Callable[[str], Any], text: str) -> None:
    _read(read, text)


@pytest.mark.parametrize("parse", [parse_json, parse_toml, parse_yaml])
@given(text=WORDS)
def test_any_text_is_plain_values_or_refused(parse: Callable[[str, str], Any], text: str) -> None:
    value = _read(parse, text, "file")
    assert value is _REFUSED or _plain(value)


def _plain(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_plain(inner) for inner in value.values())
    if isinstance(value, list):
        return all(_plain(inner) for inner in value)
    # TOML has dates; they stay what they are, and no option takes them. YAML has bytes and sets.
    return value is None or not callable(value)


@given(st.lists(st.text(min_size=1, max_size=200), min_size=1, max_size=8, unique=True))
def test_any_names_of_frames_become_different_names_of_files(names: list[str]) -> None:
    files = distinct_names(names)
    assert set(files) == set(names)
    assert len({file.lower() for file in files.values()}) == len(names)
    for file in files.values():
        assert 0 < len(file) < 200
        assert not set(file) & set('/\\:*?"<>|\0\n')
        assert not file.startswith(".")
