"""JSON, TOML and YAML from outside: plain values, or one line."""

from __future__ import annotations

import pytest
from p2o import InputError
from p2o.files.parsed_text import parse_json, parse_toml, parse_yaml

BOMB = "a: &a [1,1,1,1,1,1,1,1]\n" + "".join(f"{y}: &{y} [*{x},*{x},*{x},*{x}]\n" for x, y in zip("abcde", "bcdef"))  # noqa: B905


@pytest.mark.parametrize("text", [BOMB, "a: &a 1\nb: *a", "a: &a {x: 1}\nb:\n  <<: *a", "[&a x, *a]",
    "!!python/object/apply:os.system ['true']", "!!python/name:os.system", "!thing 1"])  # fmt: skip
def test_aliases_and_objects_are_refused_before_anything_is_built(text: str) -> None:
    with pytest.raises(InputError, match="objects, which are not supported" if text[0] == "!" else "alias"):
        parse_yaml(text, "frame file")


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_json, "[" * 100 + "]" * 100),
        (parse_json, "[" * 100_000),
        (parse_yaml, "[" * 100 + "]" * 100),
        (parse_yaml, "[" * 100_000),
        (parse_yaml, "{a: " * 5_000),
        (parse_yaml, "".join(" " * i + "a:\n" for i in range(3_000))),
        (parse_toml, "a = " + "[" * 100 + "]" * 100),
        (parse_toml, "a = " + "[" * 100_000),
        (parse_toml, ".".join("a" * 5_000) + " = 1"),
    ],
)
def test_text_that_nests_without_end_is_one_line(parse, text: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError) as caught:
        parse(text, "file")
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("parse", "text"), [(parse_json, '{"a": [%s]}'), (parse_toml, "a = [%s]"), (parse_yaml, "a: [%s]")]
)
def test_integers_that_fit_no_float_or_that_python_does_not_read_are_one_line(parse, text: str) -> None:  # type: ignore[no-untyped-def]
    for number in ("9" * 400, "-" + "9" * 400):
        with pytest.raises(InputError, match="the file contains too large a number"):
            parse(text % number, "file")
    with pytest.raises(InputError, match=r"is not (JSON|TOML|YAML)"):
        parse(text % ("9" * 5000), "file")
    assert parse(text % 2**128, "file") == {"a": [2**128]}


@pytest.mark.parametrize("text", ["a: 1\nb: 2\na: 3", "- {x: 1}\n- {x: 1, y: 2, x: 1}", "a: {'b': 1, b: 1}"])
def test_a_key_that_a_mapping_repeats_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=r"the file is not YAML; got key '[abx]' is given twice .*line [12]"):
        parse_yaml(text, "file")


def test_yaml_gives_plain_values_and_dates_stay_texts() -> None:
    assert parse_yaml("{day: 2011-09-26, at: 12, on: true, list: [1.5, x, null]}", "value") == {
        "day": "2011-09-26",
        "at": 12,
        True: True,  # YAML 1.1: the word `on` is a switch
        "list": [1.5, "x", None],
    }


@pytest.mark.parametrize("parse", [parse_json, parse_yaml])
@pytest.mark.parametrize("text", ['"a\\ud800"', '["\\udfff"]', '{"\\ud83d": 1}', '{"a": ["\\ud800"]}'])
def test_half_of_a_letter_which_no_file_can_hold_is_one_line(parse, text: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(InputError, match=r"a lone surrogate|invalid Unicode"):
        parse(text, "file")
    assert parse_json('"\\ud83d\\ude00"', "file") == "\U0001f600", "two halves are one"
    # They stay where names of files may be.
    assert parse_json('["\\udcff"]', "file", halves=True) == ["\udcff"]
