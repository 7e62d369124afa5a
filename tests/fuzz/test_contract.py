"""The fuzzer sees what it is there to see: each promise broken on purpose."""

from __future__ import annotations

import resource
from pathlib import Path

import pytest

from tests.fuzz import contract, sandbox
from tests.fuzz.contract import broken
from tests.fuzz.surfaces import Case

NAMES = "import json, os, signal, sys, time; from pathlib import Path; import numpy as np"
WAITS = "try:\n Path('out/hangs').touch(); time.sleep(60)"
COMMANDS = {
    "status 70": "print('p2o: error: unexpected ValueError: x', file=sys.stderr); sys.exit(70)",
    "status 255": "raise ValueError('x')",
    "ended by signal 11": "os.kill(os.getpid(), signal.SIGSEGV)",
    "hung: busy": "while True: pass",
    "hung: asleep": "time.sleep(60)",
    "took ": "np.ones(1_700_000_000 // 8).sum()",
    "without a word": "sys.exit(2)",
    "not of p2o: libpng": "os.write(2, b'libpng warning: x\\n')",
    "control character on stdout": r"print('\x1b[31mred')",
    "must not: open '../escaped'": "Path('../escaped').write_text('x')",
    "must not: os.rename": "os.rename('in/file', 'in/other')",
    "must not: os.system": "os.system('true')",
    "not rigid": "Path('out/result.json').write_text(json.dumps({'camera_from_lidar': (2 * np.eye(4)).tolist()}))",
    "holds NaN": "Path('out/result.json').write_text('{\"camera_from_lidar\": NaN}')",
    "interrupted, and status 0": f"{WAITS}\nexcept KeyboardInterrupt: pass",
}
"""Commands that break a promise, by what is to be said of them."""
KEPT = {
    "": "Path('out/result.json').write_text(json.dumps({'camera_from_lidar': np.eye(4).tolist()})); "
    "print('p2o: a word', file=sys.stderr)",
    "out/hangs": f"{WAITS}\nexcept KeyboardInterrupt: sys.exit(130)",
}
"""Commands that keep them, by the file with which they announce to hang."""


@pytest.fixture(autouse=True)
def _room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out of account what other tests made this process hold, which its forks begin with."""
    with open("/proc/self/statm", encoding="ascii") as file:
        held = int(file.read().split()[1]) * resource.getpagesize()
    monkeypatch.setattr(contract, "PEAK_BYTES", held + 1_000_000_000)


def found(folder: Path, command: str, hangs: str) -> list[str]:
    """Return the promises that a command of Python breaks."""
    (folder / "in").mkdir()
    (folder / "in/file").touch()

    def call() -> int:
        exec(f"{NAMES}\n{command}", {})  # noqa: S102
        return 0

    case = Case(call=call, hangs=hangs)
    return broken(case, sandbox.run(case, folder, case.hangs), folder)


@pytest.mark.parametrize("fault", COMMANDS)
def test_a_broken_promise_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str) -> None:
    if fault.startswith("hung"):
        monkeypatch.setattr(sandbox, "CPU_S", 1)
        monkeypatch.setattr(sandbox, "WALL_S", 20 if fault.endswith("busy") else 3)
    lines = found(tmp_path, COMMANDS[fault], "out/hangs" if "interrupted" in fault else "")
    assert any(fault.partition(": busy")[0].partition(": asleep")[0] in line for line in lines), lines


@pytest.mark.parametrize("hangs", KEPT)
def test_a_command_that_keeps_its_promises_is_left_alone(tmp_path: Path, hangs: str) -> None:
    assert found(tmp_path, KEPT[hangs], hangs) == []
