"""--json: one object on standard output whatever else is written to it, and failures of plugins in one line."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from p2o.cli import group, main
from p2o.cli.json_output import print_json, reserved_stdout

from tests.noisy_plugin import NOISE

PLUGIN = Path(__file__).with_name("noisy_plugin.py")
DATA = "synthetic:?scenes=1&width_px=64&height_px=64&lidar=vlp-16&right=false"
RUN = ("run", DATA, "--calibrator", "noisy", "--witness", "none")


def p2o(*words: str, mode: str = "") -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "p2o", *words, "--plugin", str(PLUGIN), "--json"]
    environment = {**os.environ, "NOISY_MODE": mode, "P2O_STRICT": "1"}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=environment, timeout=120)


FORK_ENDED = "p2o: warning: ended a process that a plugin had forked and that returned from its call"


@pytest.mark.parametrize(("mode", "isolate"), [("", ()), ("", ("--isolate",)), ("fork", ()), ("fork-raises", ())])
def test_a_run_prints_one_object_whatever_a_plugin_writes(mode: str, isolate: tuple[str, ...]) -> None:
    done = p2o(*RUN, *isolate, mode=mode)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("\n") == 1
    assert set(json.loads(done.stdout)) == {"results", "failed", "summary"}
    lines = [line for line in done.stderr.splitlines() if line != NOISE]
    assert lines == [FORK_ENDED] * bool(mode)


@pytest.mark.parametrize(
    ("mode", "words", "status", "message"),
    [
        ("textless", (), 2, "calibrator 'noisy' raised TextlessError while calibrating; got no text, because"),
        ("textless-import", (), 2, "cannot load plugin noisy_plugin.py:noisy_plugin; got TextlessError: no text"),
        ("interrupt", (), 2, "calibrator 'noisy' raised KeyboardInterrupt while calibrating"),
        ("interrupt-import", (), 2, "cannot load plugin noisy_plugin.py:noisy_plugin; got KeyboardInterrupt"),
        ("interrupt", ("--isolate",), 2, "calibrator 'noisy' raised KeyboardInterrupt while calibrating"),
    ],
)
def test_failures_of_plugins_are_one_line(mode: str, words: tuple[str, ...], status: int, message: str) -> None:
    done = p2o(*RUN, *words, mode=mode)
    assert done.returncode == status
    [line] = [line for line in done.stderr.splitlines() if line != NOISE]
    assert message in line
    assert NOISE not in done.stdout


def test_fleet_prints_one_object_whatever_its_workers_write(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    from kills import write_drives

    words = ("--frames", "1", "--candidates", "1", "--extractor", "depth/rings", "--jobs", "2")
    done = p2o("fleet", "run", str(write_drives(tmp_path / "drives", 2)), "--store", str(tmp_path / "store"), *words)
    assert json.loads(done.stdout)["checked"] == 2, done.stderr
    assert NOISE in done.stderr


def test_every_command_with_json_reserves_standard_output() -> None:
    """The mechanism is that of the option: no command prints its object without it."""

    def commands(command: click.Command, name: str) -> Iterator[tuple[str, click.Command]]:
        if not isinstance(command, click.Group):
            yield name, command
            return
        context = click.Context(command)
        for each in command.list_commands(context):
            if (inner := command.get_command(context, each)) is not None:
                yield from commands(inner, f"{name} {each}")

    with_json = {n: c for n, c in commands(group, "p2o") if any("--json" in each.opts for each in c.params)}
    assert {"p2o run", "p2o check", "p2o compare", "p2o fleet run", "p2o fleet report", "p2o rig"} <= set(with_json)
    for name, command in with_json.items():
        assert "print_json(" in inspect.getsource(inspect.unwrap(command.callback)), name


def test_python_code_gets_standard_output_back(capfd: pytest.CaptureFixture[str]) -> None:
    with reserved_stdout(restored=True):
        os.write(1, b"noise")
        print("noise")
        print_json({"a": 1})
    print("after")
    assert capfd.readouterr().out == '{"a": 1}\nafter\n'
    assert main(["doctor", "--quick", "--json"]) in (0, 1)
    assert json.loads(capfd.readouterr().out)["findings"]
