"""A file is written completely or not at all."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest
from p2o import InputError
from p2o.files.whole_file import write_whole


@pytest.mark.parametrize("step", ["write_bytes", "replace"])
@pytest.mark.parametrize(
    ("problem", "raised"),
    [(OSError(errno.ENOSPC, "No space left on device"), InputError), (KeyboardInterrupt(), KeyboardInterrupt)],
    ids=["full disk", "interrupt"],
)
def test_a_write_that_fails_leaves_the_folder_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str, problem: BaseException, raised: type[BaseException]
) -> None:
    write_whole(tmp_path / "a.json", b"before")
    original = getattr(Path, step)

    def fail(path: Path, argument: object) -> None:
        if step == "write_bytes":
            original(path, b"ha")
        raise problem

    with monkeypatch.context() as patched:
        patched.setattr(Path, step, fail)
        with pytest.raises(raised):
            write_whole(tmp_path / "a.json", b"half of it")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.json", b"before")]
    write_whole(tmp_path / "a.json", b"after")
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [("a.json", b"after")]


def test_a_missing_folder_is_refused_with_the_command_that_creates_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"cannot write the file; .*; create the folder first: mkdir -p .*missing"):
        write_whole(tmp_path / "missing" / "a.json", b"")
