"""A request to end is obeyed as Python is told to, whatever packages with compiled code have been imported."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from p2o.runtime import native

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
    "a camera with distortion in a thread": """
import threading, p2o
thread = threading.Thread(target=p2o.Camera, args=('OPENCV', 64, 48, (50, 50, 32, 24, 0.1, 0, 0, 0)))
thread.start()
thread.join()""",
    "the solver ceres": "from p2o_plugins.solve.ceres import METHOD; METHOD.build(METHOD.options())",
    "the network": "import onnxruntime, cv2",
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


def test_ipp_is_disabled_for_one_thread_and_restored() -> None:
    before = cv2.ipp.useIPP()
    with ThreadPoolExecutor(1) as other:
        with native.ipp_disabled():
            assert not cv2.ipp.useIPP()
            with native.ipp_disabled():
                pass
            assert not cv2.ipp.useIPP()
            assert other.submit(cv2.ipp.useIPP).result() == before
        assert cv2.ipp.useIPP() == other.submit(cv2.ipp.useIPP).result() == before


def test_a_blur_without_ipp_does_not_depend_on_the_memory_address() -> None:
    values = np.random.default_rng(0).random((61, 83), np.float32)
    with native.ipp_disabled():
        blurred = set()
        for offset in range(16):
            memory = np.zeros(values.size + 16, np.float32)[offset : offset + values.size].reshape(values.shape)
            memory[:] = values
            blurred.add(cv2.GaussianBlur(memory, (0, 0), 3.0).tobytes())
    assert len(blurred) == 1


PAGES = """
import resource, numpy
{setup}
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    numpy.ones(1 << 20)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
_PAGES_OF_ARRAY = (8 << 20) // 4096
SETUPS = {
    "a calibration in Python": "import p2o; p2o.Recipe.of().resolve(p2o.Registry.load()).assembly()",
    "a worker of a study": "from p2o_study import parallel; parallel._set_up_worker()",
}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mallopt is of glibc")
@pytest.mark.parametrize("name", SETUPS)
def test_freed_memory_is_kept_although_dask_asks_malloc_to_return_it(name: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", PAGES.format(setup=SETUPS[name])],
        env={**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(done.stdout) < 5 * _PAGES_OF_ARRAY
