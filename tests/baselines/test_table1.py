"""The study of the paper's Table I: what it states resolves on both kinds of data, and what it prints is right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import p2o_baselines
import pytest
from p2o import Registry, pose_error
from p2o.cli import main
from p2o.geometry.pose_error import AXES
from p2o_sim.write import vkitti2 as write_vkitti2
from p2o_study.rows import Rows
from p2o_study.study import check_study, find_study
from p2o_testing import stage

STUDY = find_study("table1", Registry.load())
NAMES = [f"test{i}" for i in range(1, 6)]
KINDS = ("", ", network", ", joint")


@pytest.mark.parametrize("data", [None, "vkitti2:somewhere?mount=camera"])
def test_the_rows_are_those_of_the_paper(data: str | None) -> None:
    """Sec. IV-B: 64 beams with 0, 25, 45 % missing edges, doubled noise, 32 beams; alone, and ten frames together."""
    registry = Registry.load()
    rows = check_study(STUDY.overridden([] if data is None else [data]), registry)
    assert [row.label for row in rows] == [f"{name}{kind}" for kind in KINDS for name in NAMES]
    assert [row.joint for row in rows] == [0] * 10 + [10] * 5
    for row, lidar, noise_m, angle_noise_deg, missing in zip(
        rows,
        (["hdl-64e"] * 4 + ["hdl-32e"]) * 3,
        [0.02, 0.02, 0.02, 0.04, 0.02] * 3,
        [0, 0, 0, 0.005, 0] * 3,
        [0, 0.25, 0.45, 0, 0] * 3,
        strict=True,
    ):
        plan = row.resolve(registry, row.seeds[0])
        options = plan.parts["data"].options
        assert (options.lidar, options.noise_m, options.angle_noise_deg) == (lidar, noise_m, angle_noise_deg)
        assert not options.mask_foliage
        assert row.damage(row.seeds[0]).missing_edges == missing
        assert plan.recipe.perturb == "2deg 0.15m"
        assert plan.recipe.extractor == ("p2ornet/rings" if row.label.endswith("network") else "depth/rings")
        assert data is not None or options.scenes >= 40


def test_it_prints_means_and_medians_beside_the_papers_and_refused_frames_count(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """On frames in the layout of Virtual KITTI 2, without the search; test3 asks for more pairs than there can be."""
    monkeypatch.setenv("P2O_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("P2O_PLUGINS", raising=False)
    list(write_vkitti2.write([stage.frame()] * 3, tmp_path / "data"))
    few = "options.damage.missing_edges = 0.45"
    shipped = Path(p2o_baselines.__file__).parent / "studies/table1.toml"
    text = shipped.read_text(encoding="utf-8").replace('init = "search"', 'init = "given"')
    file = tmp_path / "table1.toml"
    file.write_text(text.replace(few, f"{few}\noptions.pipeline.min_matches = 1000000"))
    words = ["ablate", str(file), "--data", f"vkitti2:{tmp_path / 'data'}?mount=camera", "--jobs", "1", "--quiet"]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = Rows(tmp_path / "out").planned("table1")
    assert len(rows) == 10 * 3 + 5 * 3, "three frames alone, and three starts of them together"
    for label in [f"{name}{kind}" for kind in KINDS for name in NAMES]:
        own = [row for row in rows if row.row == label]
        # A refused frame is stored with the pose that it is left with: its start.
        left_with = [row.estimate if row.solved else row.case.start for row in own]
        errors = [pose_error(pose, row.case.truth).per_axis for pose, row in zip(left_with, own, strict=True)]
        number = next(i for i, line in enumerate(lines) if line.startswith(f"{label}  "))
        refused = "3" if label.startswith("test3") else "0"
        cells = lines[number].removeprefix(label).split()
        assert cells[:3] == ["3", "3", refused]
        below = next(i for i in range(number + 1, len(lines)) if lines[i].startswith(f"{label}  "))
        expected = [np.mean([abs(error[axis]) for error in errors]) for axis in AXES]
        scaled = np.multiply(expected, [1.0] * 3 + [100.0] * 3)
        means = [scaled[:3].mean(), scaled[3:].mean()]
        assert np.allclose([float(cell) for cell in lines[below].split()[-8:]], [*scaled, *means], atol=0.06)
        if label in NAMES:
            paper = next(row.values for row in STUDY.published if row.beside == label)
            cells = lines[below + 1].split()
            assert "(published)" in cells
            numbers = [float(cell) for cell in cells[-8:-2]]
            assert np.allclose(numbers, [paper[axis] * (100 if axis.endswith("_m") else 1) for axis in AXES], atol=0.06)
