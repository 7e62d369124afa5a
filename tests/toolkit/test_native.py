"""A request to end is obeyed as Python is told to, whatever packages with compiled code have been imported."""

from __future__ import annotations

import subprocess
import sys

import pytest
from p2o import native

CODE = """
import os, signal, sys
def interrupt(number, frame):
    raise KeyboardInterrupt
signal.signal(signal.SIGTERM, interrupt)
{work}
try:
    os.kill(os.getpid(), signal.SIGTERM)
    signal.pause()
except KeyboardInterrupt:
    sys.exit(130)
"""
WORK = {
    "a camera with distortion": "import p2o; p2o.Camera('OPENCV', 64, 48, (50, 50, 32, 24, 0.1, 0, 0, 0))",
    "the solver ceres": "from p2o_plugins.solve.ceres import METHOD; METHOD.build(METHOD.options())",
    "the network": "import onnxruntime, onnx, cv2",
    "a training": "import torch, kornia, cv2",
}


@pytest.mark.parametrize("name", WORK)
def test_sigterm_still_interrupts_after(name: str) -> None:
    done = subprocess.run([sys.executable, "-c", CODE.format(work=WORK[name])], capture_output=True, timeout=120)
    assert (done.returncode, done.stdout) == (130, b""), done.stderr.decode()[-500:]


@pytest.mark.parametrize(
    ("platform", "there", "device", "found"),
    [
        ("linux", "libcuda.so.1", False, True),
        ("linux", "", False, False),
        ("linux", "", True, True),
        ("win32", "nvcuda.dll", False, True),
        ("darwin", "", False, False),
    ],
)
def test_a_driver_of_gpus_is_a_library_that_loads_or_a_device(
    platform: str, there: str, device: bool, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def load(name: str) -> object:
        if name != there:
            raise OSError(f"{name}: cannot open shared object file")
        return object()

    monkeypatch.setattr(native.ctypes, "CDLL", load)
    monkeypatch.setattr(native.sys, "platform", platform)
    monkeypatch.setattr(native.os.path, "exists", lambda path: device and path == "/dev/kfd")
    assert native.has_gpu_driver() == found
