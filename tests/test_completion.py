"""Shell completion: the scripts of shells, and the names that bash completes."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from p2o.cli import group, main


def completions(*args: str, word: str = "") -> list[str]:
    return [item.value for item in ShellComplete(group, {}, "p2o", "_P2O_COMPLETE").get_completions([*args], word)]


@pytest.mark.parametrize(
    ("args", "word", "expected"),
    [
        ((), "comp", "compare"),
        (("run",), "--fra", "--frames"),
        (("run",), "kitti-r", "kitti-raw:"),
        (("run", "--data"), "synth", "synthetic:"),
        (("run", "--method"), "ni", "nid"),
        (("run", "--matcher"), "og", "ogm"),
        (("run", "--extractor"), "p2o", "p2ornet/"),
        (("run", "--extractor"), "p2ornet/ri", "p2ornet/rings"),
        (("run", "--set"), "pipeline.most_d", "pipeline.most_deg="),
        (("run", "--export"), "js", "json:"),
        (("run", "--protocol"), "lccnet-1", "lccnet-1"),
        (("compare", "--methods"), "ours,ni", "ours,nid"),
        (("methods",), "gm", "gmm"),
        (("fleet",), "re", "report"),
    ],
)
def test_names_of_commands_options_methods_and_data_sets_are_completed(
    args: tuple[str, ...], word: str, expected: str
) -> None:
    assert expected in completions(*args, word=word)


def test_paths_follow_the_name_of_a_data_set(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    (tmp_path / "frames.json").touch()
    expected = [f"folder:{tmp_path}/frames{end}" for end in ("/", ".json")]
    assert completions("run", word=f"folder:{tmp_path}/fr") == expected


@pytest.mark.parametrize(("text", "status"), [("bash_source", 0), ("zsh_source", 0), ("fish_source", 0), ("x", 2)])
def test_the_script_of_a_shell_is_printed(
    text: str, status: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("_P2O_COMPLETE", text)
    assert main([]) == status
    captured = capsys.readouterr()
    assert ("_p2o_completion" in captured.out) == (status == 0)
    assert captured.err.count("\n") == (status != 0)


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_parts_of_words_after_colons_and_equals_signs(tmp_path: Path) -> None:
    program = tmp_path / "p2o"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m p2o "$@"\n')
    program.chmod(0o755)
    (tmp_path / "frames").mkdir()
    script = f"""
    eval "$(_P2O_COMPLETE=bash_source p2o)"
    try() {{ COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=(); _p2o_completion p2o; echo "${{COMPREPLY[*]}}"; }}
    try p2o run --method hand-ey
    try p2o run folder : {tmp_path}/fr
    try p2o run --data = kitti-r
    """
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.splitlines() == ["hand-eye", f"{tmp_path}/frames/", "kitti-raw:"]
