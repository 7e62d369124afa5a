from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from p2o import InputError
from p2o_datasets.bags.messages import POINT_CLOUD, LivoxMessage, PointCloudMessage, PointField, read_message
from p2o_datasets.bags.point_columns import columns_of, named_columns, seconds_after, usable_points

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
@settings(max_examples=60)
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
    found = named_columns(columns_of(message))
    assert found["x"].tolist() == [1, 2, 3, 4, 5]
    assert found["intensity"].tolist() == [0, 1, 2, 3, 4]
    assert found["time"].tolist() == [0, 1000, 2000, 3000, 4000]
    assert "ring" not in found  # lines of a rosette are none of a sensor that spins


@pytest.mark.parametrize(
    ("column", "target"),
    [
        *(("reflectivity", "intensity"), ("Intensity", "intensity"), ("i", "intensity"), ("channel", "ring")),
        *(("line", "ring"), ("row", "ring"), ("laser_id", "ring"), ("t", "time"), ("timestamp", "time")),
        *(("offset_time", "time"), ("time_stamp", "time")),
    ],
)
def test_columns_are_found_by_the_names_of_all_drivers(column: str, target: str) -> None:
    values = np.arange(3)
    assert named_columns({"x": values, column: values + 1})[target].tolist() == [1, 2, 3]


def test_an_intensity_wins_over_a_reflectivity() -> None:
    assert named_columns({"reflectivity": np.zeros(1), "intensity": np.ones(1)})["intensity"] == [1]


TURN_S = np.linspace(0, 0.0998, 500)


@pytest.mark.parametrize(
    ("times", "accuracy_s"),
    [
        (TURN_S.astype(np.float32), 1e-7),
        (TURN_S, 1e-9),
        ((TURN_S * 1e3).astype(np.float32), 1e-7),
        ((TURN_S * 1e6).astype(np.float32), 1e-7),
        ((TURN_S * 1e6).round().astype(np.uint32), 1e-6),
        ((TURN_S * 1e9).round().astype(np.uint32), 1e-8),
        (STAMP_NS * 1e-9 + TURN_S, 5e-7),
        ((STAMP_NS + TURN_S * 1e9).astype(np.float64), 5e-7),
        (STAMP_NS + (TURN_S * 1e9).round().astype(np.uint64), 1e-8),
        ((STAMP_NS // 1000 + (TURN_S * 1e6).round().astype(np.int64)), 3e-6),
    ],
    ids=["s-f4", "s", "ms", "us-f4", "us", "ns", "since-1970", "ns-f8", "ns-u8", "us-i8"],
)
def test_the_unit_of_times_is_told_by_how_long_a_sweep_takes(times: Any, accuracy_s: float) -> None:
    image_ns = STAMP_NS + 40_000_000
    found, remark = seconds_after(times, np.ones(500, bool), STAMP_NS, image_ns)
    assert remark is None
    assert found is not None
    assert np.abs(found - (TURN_S - 0.04)).max() < accuracy_s


def test_times_before_the_stamp_stay_before_it() -> None:
    found, _ = seconds_after(TURN_S - 0.0998, np.ones(500, bool), STAMP_NS, STAMP_NS)
    assert found is not None
    assert np.allclose(found, TURN_S - 0.0998, atol=1e-9)


@pytest.mark.parametrize("times", [TURN_S * 20, TURN_S * 1e-4, TURN_S * 1e12])
def test_a_unit_that_cannot_be_told_is_asked_for(times: Any) -> None:
    with pytest.raises(InputError, match=r"unit of the points' times is ambiguous.*--set data.point_times=ns"):
        seconds_after(times, np.ones(500, bool), STAMP_NS, STAMP_NS)


def test_a_unit_that_is_given_is_taken_and_none_leaves_times_out() -> None:
    found, _ = seconds_after(TURN_S * 20, np.ones(500, bool), STAMP_NS, STAMP_NS, "s")
    assert found is not None
    assert found.max() == pytest.approx(20 * 0.0998)
    assert seconds_after(TURN_S * 20, np.ones(500, bool), STAMP_NS, STAMP_NS, "none") == (None, None)


@pytest.mark.parametrize("start_s", [5.0, 1e9, -7.0])
def test_times_on_another_clock_are_refused(start_s: float) -> None:
    with pytest.raises(InputError, match=r"on different clocks.*data.point_times=none"):
        seconds_after(start_s + TURN_S, np.ones(500, bool), STAMP_NS, STAMP_NS)


def test_times_beyond_all_clocks_are_refused() -> None:
    times = np.array([1e300, np.nextafter(1e300, 2e300)])
    with pytest.raises(InputError, match="on different clocks"):
        seconds_after(times, np.ones(2, bool), STAMP_NS, STAMP_NS, "s")


def test_times_that_say_nothing_are_left_out_with_a_remark() -> None:
    found, remark = seconds_after(np.zeros(9), np.ones(9, bool), STAMP_NS, STAMP_NS)
    assert found is None
    assert remark is not None
    assert "all are the same" in remark
    found, remark = seconds_after(np.full(9, np.nan), np.ones(9, bool), STAMP_NS, STAMP_NS)
    assert found is None
    assert remark is not None
    assert "not finite" in remark


def test_times_of_missing_returns_do_not_count() -> None:
    times = (TURN_S * 1e9).round().astype(np.uint32) + 5_000_000
    times[::7] = 0
    columns = {axis: np.where(times == 0, np.nan, 1.0) for axis in "xyz"}
    usable = usable_points(columns)
    assert usable.sum() == np.count_nonzero(times)
    found, _ = seconds_after(times, usable, STAMP_NS, STAMP_NS)
    assert found is not None
    assert np.allclose(found[usable], TURN_S[usable] + 0.005, atol=1e-8)


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
