"""Words of the command line mean one thing wherever they are written; tests/toolkit/run/test_recipe.py has more."""

from __future__ import annotations

import pytest
from p2o import InputError, UnknownNameError
from p2o.run import words
from p2o.run.words import NamedData, data_by_name, parse_fields, parse_settings


@pytest.mark.parametrize(
    ("text", "name", "data"),
    [
        ("streets=kitti-raw:/a", "streets", "kitti-raw:/a"),
        (" My streets = synthetic:?scenes=2", "My streets", "synthetic:?scenes=2"),
        ("synthetic:?scenes=2&seed=1", "", "synthetic:?scenes=2&seed=1"),
        ("folder:/a=b", "", "folder:/a=b"),
        ("/a=b", "", "/a=b"),
        ("x=folder:/a=b", "x", "folder:/a=b"),
        ("=folder:/a", "", "=folder:/a"),
    ],
)
def test_a_name_ends_at_the_first_equals_sign_before_the_dataset(text: str, name: str, data: str) -> None:
    assert NamedData.of(text) == NamedData(name, data)


def test_data_without_a_name_are_for_the_only_dataset_and_of_several_one_is_named() -> None:
    assert data_by_name(["one=folder:/a", "folder:/b"], ["one"], "study s") == {"one": "folder:/b"}
    assert data_by_name([], ["one", "two"], "study s") == {}
    assert data_by_name(["two=folder:/a"], ["one", "two"], "study s") == {"two": "folder:/a"}
    with pytest.raises(InputError, match="dataset of study s is meant; expected NAME=DATASET:PATH with a NAME of one,"):
        data_by_name(["folder:/a"], ["one", "two"], "study s")
    with pytest.raises(UnknownNameError, match=r"unknown dataset of study s 'tow'.*did you mean two"):
        data_by_name(["tow=folder:/a"], ["one", "two"], "study s")
    with pytest.raises(UnknownNameError, match="none available"):
        data_by_name(["folder:/a"], [], "the studies")


def test_fields_are_set_over_values_that_stay_as_they_are() -> None:
    preset = {"steps": 3, "crop": {"width": 4, "height": 5}}
    said = parse_fields(["crop.width=8", "rate=0.1", "rate=0.2"], preset)
    assert said == {"steps": 3, "crop": {"width": "8", "height": 5}, "rate": "0.2"}
    assert preset == {"steps": 3, "crop": {"width": 4, "height": 5}}
    assert parse_fields(["crop.width=8"], {"crop": 3}) == {"crop": {"width": "8"}}
    assert parse_fields(["crop={width: 3, height: 2}", "crop.width=8"]) == {"crop": {"width": "8", "height": 2}}


@pytest.mark.parametrize("settings", [["x=1", "x.y=2"], ["x.y=2", "x=1"], ["x.y=2", "x={z: 1}"], ["x=1", "x.y.z=2"]])
def test_a_setting_does_not_silently_replace_one_of_another_field(settings: list[str]) -> None:
    with pytest.raises(InputError, match=r"^--set: x[.y]* is set already; expected a value, or options in it"):
        parse_fields(settings)
    with pytest.raises(InputError, match=r"^--set: data\.x[.y]* is set already"):
        parse_settings([f"data.{text}" for text in settings])
    with pytest.raises(InputError, match=r"the option a is said twice; expected each once; got folder:\?a=1&b=2&a=3"):
        words.split_data("folder:?a=1&b=2&a=3")


@pytest.mark.parametrize("text", ["rate", "=3", "a b=3", "a..b=3", ".a=3"])
def test_a_field_that_cannot_be_read_is_told_with_an_example(text: str) -> None:
    with pytest.raises(InputError, match="--set: cannot read the setting; expected FIELD=VALUE: rate=1; got"):
        parse_fields([text], example="rate=1")
