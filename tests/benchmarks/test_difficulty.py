"""The table of figures of synthetic and real frames."""

from __future__ import annotations

import sys

import difficulty
import pytest

DATA = "synthetic:?width_px=414&height_px=126"


def test_each_image_extractor_has_a_column_of_synthetic_and_one_of_real_frames(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--data", f"{DATA}&seed=2", "--synthetic", f"{DATA}&seed=1", "--scenes", "1", "--extractors", "stereo"]
    monkeypatch.setattr(sys, "argv", ["difficulty.py", *words])
    difficulty.main()
    lines = capsys.readouterr().out.splitlines()
    assert "stereo/rings, ogm, search" in lines
    assert next(line for line in lines if line.startswith("|")).split() == ["|", "|", "synthetic", "|", "real", "|"]
    [frames] = [line for line in lines if line.startswith("| frames |")]
    real = int(frames.split("|")[3])
    assert int(frames.split("|")[2]) == 1
    assert real >= 1
