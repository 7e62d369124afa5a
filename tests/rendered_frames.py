"""Synthetic frames of a test run on disk: each is rendered once, and all workers read it."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from p2o import Frame
from p2o_sim import synthetic

MAX_FRAMES = 150
"""Frames that are stored at once, about 13 MB each."""

rendered: Callable[..., Frame] = synthetic.frame


@contextmanager
def stored_in(folder: Path) -> Iterator[None]:
    """Let the data set `synthetic` take its frames from a folder; those that are missing are rendered and stored."""

    def frame(options: synthetic.SyntheticOptions, *entry: Any) -> Frame:
        key = hashlib.sha256(repr((options.model_dump_json(), entry)).encode()).hexdigest()[:24]
        path = folder / f"{key}.pickle"
        try:
            stored: Frame = pickle.loads(path.read_bytes())  # noqa: S301  (this run has written it)
        except FileNotFoundError:
            stored = rendered(options, *entry)
            if len(list(folder.iterdir())) < MAX_FRAMES:
                part = folder / f"{key}-{id(stored)}.part"
                part.write_bytes(pickle.dumps(stored, protocol=5))
                part.replace(path)
        return stored

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "frame", frame)
        yield


@contextmanager
def all_rendered() -> Iterator[None]:
    """Let the data set `synthetic` render every frame, for tests of the simulator itself."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synthetic, "frame", rendered)
        yield


@pytest.fixture(autouse=True, scope="module")
def frames_are_rendered() -> Iterator[None]:
    """Render every frame, in the modules that import this fixture."""
    with all_rendered():
        yield
