"""What is wrong with a value is told in one way, wherever the value comes from."""

from __future__ import annotations

import json
from typing import Any, Literal

import p2o
import pytest
from p2o import InputError, UnknownNameError
from p2o.options import validated
from pydantic import Field, field_validator, model_validator


class Crop(p2o.Options):
    width: int = p2o.field(8, ge=1, le=99, help="Width.")
    height: int = p2o.field(8, ge=1, help="Height.")


class Words(p2o.Options):
    name: str = p2o.field(..., help="A name.", pattern="^[a-z]+$")
    crop: Crop = p2o.field(Crop(), help="A crop.")
    crops: tuple[Crop, ...] = p2o.field((), help="Crops.")
    by_name: dict[str, Crop] = Field(default_factory=dict)
    either: bool | tuple[int, int] = p2o.field(False, help="One of two.")
    rule: Literal["hard", "soft"] = p2o.field("hard", help="A choice.")
    speeds: dict[Literal["fast", "slow"], float] = Field(default_factory=dict)

    @field_validator("name")
    @classmethod
    def _plain(cls, value: str) -> str:
        if value == "odd":
            raise ValueError("a name that is not odd")
        return value

    @model_validator(mode="after")
    def _together(self) -> Words:
        if self.crop.height == 13:
            raise ValueError("no crop of height 13")
        return self


def told(within: str = "", where: object = None, **values: Any) -> str:
    with pytest.raises(InputError) as caught:
        validated(Words, {"name": "a", **values}, within, where=where)
    return str(caught.value)


def test_a_bound_is_told_apart_from_another_form_and_faults_of_the_whole_do_not_show_all_of_it() -> None:
    assert told(rule="firm") == "rule is not valid; expected 'hard' or 'soft'; got firm"
    assert told(name="").startswith("name is not valid; expected string should match")
    assert told(name="odd") == "name is out of bounds; expected a name that is not odd; got odd"
    assert told(name="").endswith("got nothing")
    assert told(crop={"height": 13}) == "the value is out of bounds; expected no crop of height 13"
    assert told("w", crop={"height": 13}) == "w is out of bounds; expected no crop of height 13"
    with pytest.raises(InputError, match="the value is not valid; expected a valid dictionary"):
        validated(Words, [1])


def test_the_first_fault_is_told_with_its_path_and_the_number_of_others_and_what_is_missing() -> None:
    with pytest.raises(InputError) as caught:
        validated(Words, {}, where="a.toml")
    assert str(caught.value) == "a.toml: name is missing; expected a value: it has no default"
    assert validated(Words, {"name": "a", "crop": {"width": "3"}}, "words").crop == Crop(width=3)
    text = "w.crop.width is out of bounds; expected less than or equal to 99; got 100; 1 further faults"
    assert told("w", crop={"width": 100, "height": 0}) == text
    assert told(crops=[{}, {"height": "x"}]).startswith("crops.1.height is not valid; expected a valid integer")
    assert told(either=[1]) == "either is not valid; expected a valid boolean; got [1]; 1 further faults"
    assert told(by_name={"b": {"width": 0}}, where="a.yaml").startswith("a.yaml: by_name.b.width is out of bounds;")
    assert told(speeds={"quick": 1.0}).startswith("speeds.quick is not valid; expected 'fast' or 'slow'")
    assert "tuple[" not in told(either=[1, "x"]).partition(";")[0], "a name that pydantic gives to an alternative"


@pytest.mark.parametrize(
    ("values", "known"),
    [
        ({"crup": {}}, ["by_name", "crop", "crops", "either", "name", "rule", "speeds"]),
        ({"crop": {"widht": 1}}, ["height", "width"]),
        ({"crops": [{"widht": 1}]}, ["height", "width"]),
        ({"by_name": {"crop": {"widht": 1}}}, ["height", "width"]),
    ],
)
def test_an_unknown_name_is_told_with_those_of_its_own_table(values: dict[str, Any], known: list[str]) -> None:
    with pytest.raises(UnknownNameError, match="did you mean") as caught:
        validated(Words, {"name": "a", **values}, "w")
    assert caught.value.known == known
    assert caught.value.kind == "w option"
    with pytest.raises(UnknownNameError, match=r"a\.yaml: unknown key"):
        validated(Words, {"name": "a", **values}, where="a.yaml")


def test_sets_are_written_in_order_on_every_process() -> None:
    class Sets(p2o.Options):
        names: frozenset[str] = p2o.field(frozenset("qwertyuiop"), help="Names.")
        numbers: set[int] = p2o.field({8, 1, 16}, help="Numbers.")

    plain = {"names": sorted("qwertyuiop"), "numbers": [1, 16, 8]}  # by their texts
    assert Sets().model_dump(mode="json") == plain
    assert json.loads(Sets().model_dump_json()) == plain
    assert Sets().model_dump()["names"] == frozenset("qwertyuiop")
