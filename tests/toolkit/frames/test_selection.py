from __future__ import annotations

import json
from pathlib import Path

import pytest
from p2o import InputError, UnknownNameError
from p2o.frames.selection import select

DAY = "2020_01_02"
NAMES = [f"{DAY}/0005/{n:010d}" for n in (0, 10, 59)] + [f"{DAY}/0011/{n:010d}" for n in range(100, 109)] + ["mine"]


@pytest.mark.parametrize(
    ("spec", "chosen"),
    [
        ("all", list(range(13))),
        ("0,3,2", [0, 3, 2]),
        ("-1, -13", [12, 0]),
        ("5-9", [5, 6, 7, 8, 9]),
        ("4-4", [4]),
        ("2:10:3", [2, 5, 8]),
        ("10:", [10, 11, 12]),
        ("::-6", [12, 6, 0]),
        ("-2:", [11, 12]),
        ("10:99", [10, 11, 12]),
        (f"{DAY}/0005/0000000010", [1]),
        ("0005/0000000059", [2]),
        ("0000000059", [2]),
        ("mine", [12]),
        ("7,0000000010,5-6,-1", [7, 1, 5, 6, 12]),
        ("3,3,2-4,0:4", [3, 2, 4, 0, 1]),
    ],
)
def test_words_choose_frames_in_the_order_they_are_named_each_once(spec: str, chosen: list[int]) -> None:
    assert select(NAMES, spec) == chosen


def test_numbers_with_a_leading_zero_are_names_and_others_indices() -> None:
    names = ["000000", "000006", "000001"]
    assert select(names, "1") == [1]
    assert select(names, "000001") == [2]
    assert select(names, "0") == [0]


def test_a_whole_name_is_a_name_even_if_it_looks_like_something_else() -> None:
    assert select(["5", "all", "0-1", "b"], "5,all,0-1") == [0, 1, 2]


@pytest.mark.parametrize("word", ["13", "-14", "12-13", "99-100"])
def test_an_index_out_of_range_says_what_there_is(word: str) -> None:
    with pytest.raises(InputError, match=r"--frames: frame index -?\d+ is out of range; expected 0 to 12"):
        select(NAMES, word, where="--frames")


def test_a_range_that_runs_backwards_is_turned_in_the_message() -> None:
    with pytest.raises(InputError, match="the range '9-5' runs backwards; expected 5-9"):
        select(NAMES, "9-5")


@pytest.mark.parametrize("spec", ["", "1,,2", ","])
def test_empty_words_are_refused_with_the_syntax(spec: str) -> None:
    with pytest.raises(InputError, match=r"an empty word in the selection of frames; expected all, indices"):
        select(NAMES, spec)


def test_a_choice_of_nothing_is_refused() -> None:
    with pytest.raises(InputError, match=r"no frame is selected; .*got '5:5' of 13 frames"):
        select(NAMES, "5:5")
    with pytest.raises(InputError, match=r"the slice '::0' has step 0"):
        select(NAMES, "::0")


def test_an_unknown_frame_names_the_nearest() -> None:
    with pytest.raises(UnknownNameError, match=rf"--frames: unknown frame '{DAY}/0005/0000000011'.*did you mean {DAY}"):
        select(NAMES, f"{DAY}/0005/0000000011", where="--frames")
    with pytest.raises(UnknownNameError, match=r"unknown frame '3\.5'"):
        select(NAMES, "3.5")


def test_the_end_of_several_names_is_refused_with_them() -> None:
    names = ["a/0001", "b/0001"]
    with pytest.raises(InputError, match="'0001' is the end of 2 names; expected a name; got a/0001 or b/0001"):
        select(names, "0001")


def test_only_whole_parts_of_a_name_count_as_its_end() -> None:
    with pytest.raises(UnknownNameError, match="unknown frame 'ine'"):
        select(NAMES, "ine")


def test_a_frame_that_the_dataset_left_out_says_why() -> None:
    skipped = {f"{DAY}/0005/0000000001": "0000000001.bin is missing"}
    with pytest.raises(InputError, match=r"is left out of the dataset; got 0000000001\.bin is missing"):
        select(NAMES, "0005/0000000001", skipped=skipped)


def write(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_a_split_is_a_list_of_names_in_its_order(tmp_path: Path) -> None:
    file = write(tmp_path / "splits.json", {"test": [NAMES[4], NAMES[1]], "drive_0005": [NAMES[0]]})
    assert select(NAMES, f"@{file}#test") == [4, 1]
    assert select(NAMES, f"12,@{file}#drive_0005") == [12, 0]


def test_the_split_may_be_left_out_where_there_is_one(tmp_path: Path) -> None:
    assert select(NAMES, f"@{write(tmp_path / 'list.json', NAMES[2:4])}") == [2, 3]
    assert select(NAMES, f"@{write(tmp_path / 'one.json', {'test': NAMES[:1]})}") == [0]
    two = write(tmp_path / "two.json", {"test": [], "train": []})
    with pytest.raises(InputError, match=r"two\.json: the file has several splits; expected .*test, train"):
        select(NAMES, f"@{two}")


def test_an_unknown_split_names_the_nearest(tmp_path: Path) -> None:
    file = write(tmp_path / "splits.json", {"test": NAMES[:1], "train": NAMES[1:]})
    with pytest.raises(UnknownNameError, match=r"splits\.json: unknown split 'tset'; .*did you mean test"):
        select(NAMES, f"@{file}#tset")


def test_split_entries_that_the_dataset_lacks_are_counted_and_the_first_named(tmp_path: Path) -> None:
    file = write(tmp_path / "splits.json", {"test": [NAMES[0], "gone/1", "gone/2"]})
    with pytest.raises(InputError, match=r"splits\.json: 2 of the 3 frames of split 'test' .*got gone/1"):
        select(NAMES, f"@{file}#test", where="--frames")


@pytest.mark.parametrize("text", ["{", "3", '{"test": "all"}', '{"test": [1, 2]}', "\x00"])
def test_a_file_of_another_form_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "splits.json").write_text(text)
    with pytest.raises(InputError, match=r"splits\.json: the file of splits (is not JSON|has another form)"):
        select(NAMES, f"@{tmp_path / 'splits.json'}#test")


def test_missing_folder_and_unreadable_text_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"splits\.json: the file of splits is missing"):
        select(NAMES, f"@{tmp_path / 'splits.json'}#test")
    with pytest.raises(InputError, match="the file of splits is a folder"):
        select(NAMES, f"@{tmp_path}#test")
    (tmp_path / "splits.json").write_bytes(b"\xff\xfe{}")
    with pytest.raises(InputError, match=r"splits\.json: the file of splits is not text"):
        select(NAMES, f"@{tmp_path / 'splits.json'}#test")


def test_a_dataset_without_frames_has_nothing_to_choose() -> None:
    with pytest.raises(InputError, match="frame index 0 is out of range; expected a dataset with frames"):
        select([], "0")
    with pytest.raises(InputError, match="no frame is selected"):
        select([], "all")


def test_ranges_and_slices_may_begin_at_zero_whatever_the_names_are() -> None:
    names = [f"2011_09_26/0005/{number:010d}" for number in range(20)]
    assert select(names, "0-3") == [0, 1, 2, 3]
    assert select(names, "0:6:2") == [0, 2, 4]
    assert select(names, "0") == [0]
    assert select(names, "0000000003") == [3]


@pytest.mark.parametrize(
    ("spec", "chosen"),
    [
        ("*/0005/*", [0, 1, 2]),
        ("0011/000000010?", [3, 4, 5, 6, 7, 8, 9, 10, 11]),
        ("*[57]9", [2]),
        ("m*", [12]),
        ("*0103,0-1,*/0005/*", [6, 0, 1, 2]),
    ],
)
def test_wildcards_choose_names_or_their_ends_beside_lists_and_ranges(spec: str, chosen: list[int]) -> None:
    assert select(NAMES, spec) == chosen


def test_a_name_that_contains_brackets_is_no_wildcard() -> None:
    assert select(["a[1]", "a1"], "a[1]") == [0]


def test_wildcards_without_a_match_name_the_nearest() -> None:
    with pytest.raises(InputError, match=rf"--frames: no frame matches '\*_0012/0\*'; expected nearest {DAY}/"):
        select(NAMES, "*_0012/0*", where="--frames")
    with pytest.raises(InputError, match=r"left out of the dataset; got no sweep"):
        select(NAMES, "gone*", skipped={"gone-7": "no sweep"})
