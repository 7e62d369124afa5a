from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from p2o import InputError
from p2o_datasets.bags.messages import POINT_CLOUD, LivoxMessage, PointCloudMessage, PointField, read_message
from p2o_datasets.bags.point_columns import columns_of
from p2o_datasets.point_fields import candidates

from tests.bag_files import FORMS, LIVOX, Said, cloud, header, made, serialized, store_of

STORES = {form: store_of(form) for form in FORMS}
KINDS = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
STAMP_NS = 1_700_000_000_123_456_789


def message_of(said: Said, form: str = "mcap") -> Any:
    return read_message(said.kind, serialized(STORES[form], said, form), ros1=form == "ros1")


@st.composite
def layouts(draw: st.DrawFn) -> tuple[dict[str, Any], dict[str, Any]]:
    names = draw(st.permutations(["x", "y", "z", *draw(st.lists(st.sampled_from("abcdefg"), unique=True))]))
    height, width = draw(st.integers(1, 3)), draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    columns, offsets, place = {}, [], 0
    for name in names:
        kind = np.dtype(draw(st.sampled_from(KINDS)))
        place += draw(st.integers(0, 5))
        columns[name] = rng.integers(0, 100, height * width).astype(kind)
        offsets.append(place)
        place += kind.itemsize
    return columns, {
        "offsets": offsets,
        "point_step": place + draw(st.integers(0, 9)),
        "row_padding": draw(st.integers(0, 7)),
        "height": height,
        "big_endian": draw(st.booleans()),
    }


@pytest.mark.parametrize("form", ["ros1", "mcap"])
@settings(max_examples=30)
@given(drawn=layouts())
def test_columns_come_back_from_any_layout(form: str, drawn: tuple[dict[str, Any], dict[str, Any]]) -> None:
    columns, layout = drawn
    found = columns_of(message_of(cloud("/points", STAMP_NS, columns, **layout), form))
    assert list(found) == list(columns)
    for name, column in columns.items():
        assert found[name].dtype.kind == column.dtype.kind
        assert np.array_equal(found[name], column)


@pytest.mark.parametrize("form", FORMS)
def test_points_of_livox_come_back_with_the_padding_of_ros_2(form: str) -> None:
    points = [
        {"offset_time": 1000 * i, "x": 1.0 + i, "y": 2.0, "z": 3.0, "reflectivity": i, "tag": 16, "line": i % 4}
        for i in range(5)
    ]
    said = Said("/livox", LIVOX, STAMP_NS, {"header": header(STAMP_NS, "livox"), "point_num": 5, "points": points})
    message = message_of(said, form)
    assert isinstance(message, LivoxMessage)
    assert message.header.stamp_ns == STAMP_NS
    found = columns_of(message)
    assert found["x"].tolist() == [1, 2, 3, 4, 5]
    assert found["reflectivity"].tolist() == [0, 1, 2, 3, 4]
    assert found["offset_time"].tolist() == [0, 1000, 2000, 3000, 4000]
    # Lines of a rosette are not the rings of a rotating sensor.
    assert candidates(list(found)) == {"intensity": ["reflectivity"], "ring": [], "time": ["offset_time"]}


def good() -> PointCloudMessage:
    message = message_of(cloud("/points", STAMP_NS, {axis: np.ones(6, np.float32) for axis in "xyz"}, height=2))
    assert isinstance(message, PointCloudMessage)
    return message


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"data": np.frombuffer(b"12", np.uint8)}, "contradicts its layout"),
        ({"row_step": 35}, "contradicts its layout"),
        ({"width": 4}, "contradicts its layout"),
        ({"width": 1 << 31, "height": 1 << 31}, "too many points"),
        ({"point_step": 11}, "field z is outside its point"),
        ({"point_step": 0, "fields": ()}, "the points have no bytes"),
        ({"fields": (PointField("x", 0, 9, 1),)}, "unknown type"),
        ({"fields": (PointField("x", 4_294_967_295, 7, 1),)}, "is outside"),
        ({"fields": (PointField("x", 0, 7, 4_294_967_295),)}, "is outside"),
        ({"fields": (PointField("x", 0, 7, 1), PointField("x", 4, 7, 1))}, "not unique"),
        ({"fields": tuple(PointField(str(i), 0, 7, 1) for i in range(300))}, "too many fields"),
    ],
)
def test_a_cloud_that_is_not_what_it_says_is_refused(change: dict[str, Any], text: str) -> None:
    with pytest.raises(InputError, match=text):
        columns_of(replace(good(), **change))


def test_a_single_row_may_leave_its_length_out() -> None:
    message = replace(good(), height=1, width=6, row_step=0)
    assert columns_of(message)["x"].tolist() == [1.0] * 6
    message = replace(message, row_step=0, data=np.zeros(0, np.uint8), width=0)
    assert columns_of(message)["x"].tolist() == []


def test_a_field_of_several_numbers_has_no_column() -> None:
    message = replace(good(), fields=(PointField("normal", 0, 7, 3), PointField("x", 0, 7, 1)))
    assert list(columns_of(message)) == ["x"]


def test_messages_that_end_early_or_go_on_are_refused() -> None:
    said = cloud("/points", STAMP_NS, {axis: np.ones(6, np.float32) for axis in "xyz"})
    for form in ("ros1", "mcap"):
        data = serialized(STORES[form], said, form)
        for size in range(len(data) - 3):
            with pytest.raises(InputError, match=r"damaged or truncated|not in plain CDR|length does not match"):
                read_message(POINT_CLOUD, data[:size], ros1=form == "ros1")
        with pytest.raises(InputError, match="length does not match its type"):
            read_message(POINT_CLOUD, data + b"1234", ros1=form == "ros1")
    with pytest.raises(InputError, match="not in plain CDR"):
        read_message(POINT_CLOUD, b"\0\7" + data[2:], ros1=False)
    with pytest.raises(InputError, match=r"does not read messages of type std_msgs/String.*sensor_msgs/Image"):
        read_message("std_msgs/msg/String", data, ros1=False)


def test_messages_in_big_endian_cdr_are_read() -> None:
    said = cloud("/points", STAMP_NS, {axis: np.arange(6, dtype=np.float32) for axis in "xyz"})
    store = STORES["mcap"]
    data = bytes(store.serialize_cdr(made(store, said.kind, said.fields), said.kind, little_endian=False))
    assert columns_of(read_message(POINT_CLOUD, data, ros1=False))["y"].tolist() == [0, 1, 2, 3, 4, 5]
