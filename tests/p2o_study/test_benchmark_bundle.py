"""Bundles are accepted as they were measured, and refused with their own message where something was changed."""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from p2o import se3

from tests.p2o_study.benchmark_board import Board

Contents = dict[str, str]


@pytest.fixture
def bundle(board: Board) -> Path:
    board.measured()
    path = board.root / "tiny.zip"
    assert board.command("bundle", "--out", str(path)) == 0
    return path


def edited(path: Path, edit: Callable[[Contents], None]) -> None:
    """Rewrite a bundle with other contents."""
    with zipfile.ZipFile(path) as archive:
        contents = {name: archive.read(name).decode() for name in archive.namelist()}
    edit(contents)
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in contents.items():
            archive.writestr(name, text)


def with_manifest(edit: Callable[[Contents], None]) -> Callable[[Contents], None]:
    """Return an edit that also makes the digests of the manifest right."""

    def also(contents: Contents) -> None:
        edit(contents)
        manifest = json.loads(contents["manifest.json"])
        lines = contents["rows.jsonl"].splitlines()
        manifest["rows"] = [hashlib.sha256(line.encode()).hexdigest() for line in lines]
        contents["manifest.json"] = json.dumps(manifest)

    return also


def other_pose(contents: Contents) -> None:
    """Replace the pose of the last row, of `quick`, by the truth."""
    *others, last = contents["rows.jsonl"].splitlines()
    row, frame = json.loads(last), json.loads(contents["frames.jsonl"].splitlines()[-1])
    row["estimate"] = frame["truth"]
    text = json.dumps(row, sort_keys=True, separators=(",", ":"))
    contents["rows.jsonl"] = "\n".join([*others, text]) + "\n"


def other_pose_and_error(contents: Contents) -> None:
    other_pose(contents)
    contents["errors.csv"] = re.sub(r"[\d.]+,[\d.]+\n$", "0.000000,0.000000\n", contents["errors.csv"])


def other_start(contents: Contents) -> None:
    *others, last = contents["rows.jsonl"].splitlines()
    row = json.loads(last)
    row["start"] = (np.array(row["start"]) @ se3.exp(np.array([0.01, 0, 0, 0, 0, 0]))).tolist()
    contents["rows.jsonl"] = "\n".join([*others, json.dumps(row, sort_keys=True, separators=(",", ":"))]) + "\n"


def method_by_digest(contents: Contents) -> None:
    """Replace the method of the first row by its digest, as in files of results."""
    from p2o_study.benchmark.row import Row

    first, *others = contents["rows.jsonl"].splitlines()
    contents["rows.jsonl"] = "\n".join([Row.model_validate_json(first).stored, *others]) + "\n"


def other_image(contents: Contents) -> None:
    """Replace the digest of an image everywhere, with all that follows from it."""
    from p2o_study.benchmark.row import FrameData

    for line in contents["frames.jsonl"].splitlines():
        before = FrameData.model_validate(json.loads(line))
        after = before.model_copy(update={"image": "0" * 64})
        after = FrameData.model_validate(json.loads(after.line))
        contents["frames.jsonl"] = contents["frames.jsonl"].replace(line, after.line)
        contents["rows.jsonl"] = contents["rows.jsonl"].replace(before.digest, after.digest)


def better_errors(contents: Contents) -> None:
    contents["errors.csv"] = re.sub(r"[\d.]+,([\d.]+\n)$", r"0.010000,\1", contents["errors.csv"])


def error_in_row(contents: Contents) -> None:
    contents["rows.jsonl"] = contents["rows.jsonl"].replace('"row":', '"rotation_deg":0.01,"row":', 1)


def test_a_bundle_as_measured_is_accepted(board: Board, bundle: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert board.command("verify", str(bundle), "--sample", "30") == 0
    text = capsys.readouterr().out
    assert "tiny: accepted, 30 rows" in text
    assert "30 rows compared with the data here, 30 computed again" in text


def test_equal_rows_give_equal_bundles(board: Board, bundle: Path) -> None:
    again = board.root / "again.zip"
    assert board.command("bundle", "--out", str(again)) == 0
    assert again.read_bytes() == bundle.read_bytes()


@pytest.mark.parametrize(
    ("edit", "code", "message"),
    [
        (other_pose, 1, "rows.jsonl:30: the row was changed after it was packed"),
        (with_manifest(other_pose), 1, "errors.csv:31: the stated rotation_deg is 0.5"),
        (with_manifest(other_pose_and_error), 1, "seed 4: computed again the pose is 0.5"),
        (with_manifest(other_start), 1, "seed 4: the initial guess is not that of protocol and seed"),
        (with_manifest(other_image), 1, "the frames differ from the data here"),
        (lambda c: c.update({"frames.jsonl": re.sub("[0-9a-f]{64}", "0" * 64, c["frames.jsonl"])}), 1,
         "a row names a frame that is not listed with this digest"),
        (better_errors, 1, "errors.csv:31: the stated rotation_deg is 0.010000, that of the pose 0.5"),
        (method_by_digest, 2, "rows.jsonl:1: method is not valid; expected a valid dictionary"),
        (error_in_row, 2, "rows.jsonl:1: the line states an error: rotation_deg"),
        (lambda c: c.update({"../evil": "x"}), 2, "the bundle has other files"),
        (lambda c: c.update({"manifest.json": "{}"}), 2, "manifest.json: version is missing"),
        (lambda c: c.update({"rows.jsonl": c["rows.jsonl"].split("\n")[0]}), 1, "1 rows, the manifest has 30"),
    ],
)  # fmt: skip
def test_a_tampered_bundle_is_refused_with_its_own_message(
    board: Board,
    bundle: Path,
    capsys: pytest.CaptureFixture[str],
    edit: Callable[[Contents], None],
    code: int,
    message: str,
) -> None:
    edited(bundle, edit)
    capsys.readouterr()
    assert board.command("verify", str(bundle), "--sample", "30") == code
    output = capsys.readouterr()
    assert message in output.out + output.err


def test_a_ground_truth_that_was_moved_is_refused(
    board: Board, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def moved(contents: Contents) -> None:
        lines = [json.loads(line) for line in contents["frames.jsonl"].splitlines()]
        for line in lines:
            line["truth"][0][3] += 0.01
        contents["frames.jsonl"] = "".join(json.dumps(line) + "\n" for line in lines)

    edited(bundle, moved)
    assert board.command("verify", str(bundle)) == 1
    assert "a row names a frame that is not listed with this digest" in capsys.readouterr().out


def test_a_file_that_is_no_bundle_or_unpacks_to_too_much_is_refused(
    board: Board, bundle: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("p2o_study.benchmark.bundle.MAX_BYTES", 100)
    assert board.command("verify", str(bundle)) == 2
    assert "of the bundle is too large; expected at most 100 bytes" in capsys.readouterr().err
    bundle.write_bytes(b"PK no zip")
    assert board.command("verify", str(bundle)) == 2
    assert "the bundle is not a zip file, or is damaged" in capsys.readouterr().err


def test_a_bundle_with_damaged_compressed_data_is_refused(
    board: Board, bundle: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(bundle.read_bytes())
    with zipfile.ZipFile(bundle) as archive:
        largest = max(archive.infolist(), key=lambda entry: entry.compress_size)
    begin = largest.header_offset + 100
    data[begin : begin + 60] = b"\xff" * 60
    bundle.write_bytes(data)
    assert board.command("verify", str(bundle)) == 2
    assert "the bundle is not a zip file, or is damaged" in capsys.readouterr().err


def test_a_foreign_method_is_bundled_and_verified_without_being_computed(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    starts, path = board.root / "starts.csv", board.root / "tiny.zip"
    assert board.command("starts", "--out", str(starts)) == 0
    assert board.command("score", str(starts), "--name", "nothing") == 0
    assert board.command("bundle", "--out", str(path)) == 0
    assert board.command("verify", str(path), "--sample", "15") == 0
    assert "not computed again: 15 (external method)" in capsys.readouterr().out
