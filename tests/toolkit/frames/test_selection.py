from __future__ import annotations

import json
from pathlib import Path

import pytest
from p2o import InputError
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
        ("3,3,2-4,0:4", [3, 2, 4, 0, 1]),
        # Wildcards choose names or their ends beside lists and ranges.
        ("0011/000000010?", [3, 4, 5, 6, 7, 8, 9, 10, 11]),
        ("*[57]9", [2]),
        ("m*", [12]),
        ("*0103,0-1,*/0005/*", [6, 0, 1, 2]),
    ],
)
def test_words_choose_frames_in_the_order_they_are_named_each_once(spec: str, chosen: list[int]) -> None:
    assert select(NAMES, spec) == chosen


@pytest.mark.parametrize(
    ("names", "spec", "chosen"),
    [
        # Numbers with a leading zero are names, others are indices.
        (["000000", "000006", "000001"], "1", [1]),
        (["000000", "000006", "000001"], "000001", [2]),
        (["000000", "000006", "000001"], "0", [0]),
        # A whole name is a name even if it looks like something else.
        (["5", "all", "0-1", "b"], "5,all,0-1", [0, 1, 2]),
        (["a[1]", "a1"], "a[1]", [0]),
        # Ranges and slices may begin at zero whatever the names are.
        ([f"0005/{number:010d}" for number in range(20)], "0:6:2", [0, 2, 4]),
        ([f"0005/{number:010d}" for number in range(20)], "0000000003", [3]),
    ],
)
def test_names_precede_indices_and_wildcards(names: list[str], spec: str, chosen: list[int]) -> None:
    assert select(names, spec) == chosen


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        *((word, r"--frames: frame index -?\d+ is out of range; expected 0 to 12") for word in ("13", "-14", "12-13")),
        ("9-5", "the range '9-5' runs backwards; expected 5-9"),
        *((text, "an empty word in the selection of frames; expected all, indices") for text in ("", "1,,2", ",")),
        ("5:5", "no frame is selected; .*got '5:5' of 13 frames"),
        ("::0", "the slice '::0' has step 0"),
        (f"{DAY}/0005/0000000011", rf"--frames: unknown frame '{DAY}/0005/0000000011'.*did you mean {DAY}"),
        ("3.5", r"unknown frame '3\.5'"),
        ("ine", "unknown frame 'ine'"),
        ("*_0012/0*", rf"--frames: no frame matches '\*_0012/0\*'; expected nearest {DAY}/"),
        ("0005/0000000001", r"is left out of the dataset; got 0000000001\.bin is missing"),
        ("gone*", "left out of the dataset; got no sweep"),
    ],
)
def test_words_that_choose_no_frame_are_refused(spec: str, message: str) -> None:
    skipped = {f"{DAY}/0005/0000000001": "0000000001.bin is missing", "gone-7": "no sweep"}
    with pytest.raises(InputError, match=message):
        select(NAMES, spec, where="--frames", skipped=skipped)


@pytest.mark.parametrize(
    ("names", "spec", "message"),
    [
        (["a/0001", "b/0001"], "0001", "'0001' is the end of 2 names; expected a name; got a/0001 or b/0001"),
        ([], "0", "frame index 0 is out of range; expected a dataset with frames"),
        ([], "all", "no frame is selected"),
    ],
)
def test_ambiguous_ends_and_empty_datasets_are_refused(names: list[str], spec: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        select(names, spec)


def write(path: Path, content: object) -> Path:
    path.write_text(json.dumps(content))
    return path


def test_a_split_is_a_list_of_names_in_its_order_and_may_be_left_out_where_there_is_one(tmp_path: Path) -> None:
    file = write(tmp_path / "splits.json", {"test": [NAMES[4], NAMES[1]], "drive_0005": [NAMES[0]]})
    assert select(NAMES, f"12,@{file}#test") == [12, 4, 1]
    assert select(NAMES, f"@{write(tmp_path / 'list.json', NAMES[2:4])}") == [2, 3]
    assert select(NAMES, f"@{write(tmp_path / 'one.json', {'test': NAMES[:1]})}") == [0]
    two = write(tmp_path / "two.json", {"test": [], "train": []})
    with pytest.raises(InputError, match=r"two\.json: the file has several splits; expected .*test, train"):
        select(NAMES, f"@{two}")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", "the file of splits is not JSON"),
        *((text, "the file of splits has another form") for text in (b"3", b'{"test": "all"}', b'{"test": [1, 2]}')),
        (b"\xff\xfe{}", "the file of splits is not text"),
        (b'{"tset": [], "train": []}', "unknown split 'test'; .*did you mean tset"),
        (b'{"test": ["mine", "gone/1", "gone/2"]}', "2 of the 3 frames of split 'test' .*got gone/1"),
    ],
)
def test_a_file_without_the_split_is_refused_by_name(tmp_path: Path, content: bytes, message: str) -> None:
    file = tmp_path / "splits.json"
    with pytest.raises(InputError, match=r"splits\.json: the file of splits is missing"):
        select(NAMES, f"@{file}#test")
    file.write_bytes(content)
    with pytest.raises(InputError, match=rf"splits\.json: {message}"):
        select(NAMES, f"@{file}#test")
