"""`p2o run` exports trusted results only, states what it wrote, and names the licence of the weights that were used."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Recipe, Registry
from p2o.cli import main
from p2o.results.figures import result_lines
from p2o_study.keys import method_content

pytestmark = pytest.mark.usefixtures("plain_environment")
PLUGIN = Path(__file__).with_name("stage_plugin.py")
DOUBTFUL = ["--plugin", str(PLUGIN), "--calibrator", "spy", "--perturb", "2deg 0.1m", "--witness", "none"]
SMALL = "synthetic:?scenes=1&right=false&width_px=414&height_px=125"
TRUSTED = ["run", "--data", "synthetic:?scenes=1&right=false", "--extractor", "depth/rings", "--perturb", "2deg 0.15m"]
FREE = "free: Apache-2.0; encoder initialised with weights under Apache-2.0, trained on ImageNet"
RESEARCH_ONLY = "kitti: CC-BY-NC-SA-3.0"


def doubtful(data: str, *words: str) -> list[str]:
    """Return the words that run a method without an independent check, whose results are doubtful."""
    return ["run", "--data", data, *DOUBTFUL, *words]


# ---- exports


def test_a_doubtful_result_is_exported_only_if_it_is_requested(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "calib.txt"
    assert main(doubtful("fake:?frames=1", "--export", f"kitti:{path}")) == 1
    captured = capsys.readouterr()
    reason = "the result is doubtful; see its reasons, or write it with --export-anyway"
    assert captured.err.splitlines()[-1] == f"p2o: not exported: {path}: {reason}"
    assert "wrote" not in captured.out
    assert not path.exists()
    assert main(doubtful("fake:?frames=1", "--export", f"matrix:{path}", "--export-anyway")) == 0
    assert f"wrote {path} (matrix, doubtful)\n" in capsys.readouterr().out
    assert "\n# p2o: doubtful; predicted error unknown\n" in path.read_text()


@pytest.mark.parametrize("anyway", [[], ["--export-anyway"]])
def test_a_result_that_does_not_meet_the_requirement_or_has_no_pose_is_never_exported(
    anyway: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "calib.txt"
    assert main(doubtful("fake:?frames=1", "--require", "trusted", "--export", f"kitti:{path}", *anyway)) == 1
    assert f"p2o: not exported: {path}: the result is not trusted, as --require asks\n" in capsys.readouterr().err
    refused = doubtful("fake:?frames=1", "--set", "calibrator.status=no-edges", "--export", f"kitti:{path}", *anyway)
    assert main(refused) == 1
    assert "calib.txt: the result has no estimated pose: no-edges" in capsys.readouterr().err
    assert not path.exists()


def test_json_stores_the_verdict_and_is_always_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = doubtful("fake:?frames=1", "--export", f"json:{tmp_path}/r.json")
    assert main(words) == 0
    assert json.loads((tmp_path / "r.json").read_text())["verdict"]["trust"] == "doubtful"
    assert main([*words, "--require", "trusted"]) == 1
    refused = doubtful("fake:?frames=1", "--set", "calibrator.status=no-edges", "--export", f"json:{tmp_path}/no.json")
    assert main(refused) == 1
    assert json.loads((tmp_path / "no.json").read_text())["verdict"]["trust"] == "refused"
    assert "not exported" not in capsys.readouterr().err


def test_trusted_results_are_exported_with_verdict_and_predicted_error_where_they_reach_what_is_required(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, size = tmp_path / "tf.txt", "0.001deg 0.001m"
    assert main([*TRUSTED, "--require", size, "--export", f"kitti:{path}", "--export-anyway"]) == 1
    assert f"not exported: {path}: the result does not reach {size}, as --require asks" in capsys.readouterr().err
    assert not path.exists()
    assert main([*TRUSTED, "--require", "trusted", "--export", f"ros2:{path}"]) == 0
    assert f"wrote {path} (ros2, trusted)\n" in capsys.readouterr().out
    [comment] = [line for line in path.read_text().splitlines() if line.startswith("# p2o: ")]
    assert comment.startswith("# p2o: trusted; predicted error 0.")
    assert "(67 %), " in comment
    assert comment.endswith("(95 %)")


def test_json_output_lists_the_exports_of_all_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export = ["--export", f"kitti:{tmp_path}/{{frame}}.txt", "--export", f"json:{tmp_path}/{{frame}}.json"]
    words = doubtful("fake:", "--json", "--set", "calibrator.fail_at=0", "--export-anyway", *export)
    assert main(words) == 1
    exports = json.loads(capsys.readouterr().out)["exports"]
    assert [(e["frame"], e["form"], e["trust"], e["written"]) for e in exports] == [
        ("drive/0000", "kitti", "refused", False),
        ("drive/0000", "json", "refused", True),
        ("drive/0001", "kitti", "doubtful", True),
        ("drive/0001", "json", "doubtful", True),
    ]
    for entry in exports:
        assert Path(entry["path"]).exists() == entry["written"] == (not entry["reason"])


# ---- weights


def test_a_result_names_the_licence_of_its_weights(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["run", "--data", SMALL, "--perturb", "1deg 0.05m", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    assert "  weights   free: Apache-2.0" in capsys.readouterr().out
    assert "free: Apache-2.0" in (tmp_path / "out/result.html").read_text()
    monkeypatch.setenv("P2O_WEIGHTS", "kitti")
    assert main([*words[:-2], "--json"]) == 0
    [result] = json.loads(capsys.readouterr().out)["results"]
    assert result["licences"]["extractor"] == RESEARCH_ONLY
    assert result["recipe"]["options"]["extractor"]["weights"] == "kitti"


def planned(**words: Any) -> Any:
    """Return the plan of a recipe with the installed plugins."""
    return Recipe.of(data=None, **words).resolve(Registry.load())


def test_the_independent_check_uses_and_names_the_same_default(monkeypatch: pytest.MonkeyPatch) -> None:
    assert planned(calibrator="koo").licences() == {"witness": FREE}
    assert planned(extractor="canny/rings", matcher="nearest", witness="none").licences() == {}
    monkeypatch.setenv("P2O_WEIGHTS", "kitti")
    plan = planned(calibrator="koo")
    assert plan.described()["options"]["witness"]["weights"] == "kitti"
    assert plan.licences() == {"witness": RESEARCH_ONLY}


def test_own_and_published_weights_are_named(tmp_path: Path) -> None:
    (tmp_path / "own.safetensors").touch()
    own = planned(options={"extractor": {"weights": str(tmp_path / "own.safetensors")}})
    assert own.licences() == {"extractor": "own.safetensors: the terms of its training data apply"}
    small = planned(calibrator="calibnet", witness="none").licences()
    assert small == {"calibrator": "small: CC-BY-NC-SA-3.0"}
    assert planned(calibrator="cues", witness="none").licences() == {"calibrator": FREE}


@pytest.mark.parametrize("method", [{}, {"calibrator": "cues", "witness": "none"}], ids=["p2ornet", "cues"])
def test_keys_of_studies_follow_the_weights_that_were_used(
    method: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = "calibrator" if method else "extractor"

    def content(**options: str) -> dict[str, Any]:
        return method_content(planned(**method, options={stage: options}).parts[stage])

    default, kitti = content(), content(weights="kitti")
    assert default != kitti
    monkeypatch.setenv("P2O_WEIGHTS", "kitti")
    assert content() == kitti
    monkeypatch.setenv("P2O_WEIGHTS", "")
    assert content() == default


def test_an_unknown_choice_of_weights_is_one_line(refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("P2O_WEIGHTS", "fre")
    line = refused(["run"])
    assert line.startswith("p2o: error: p2ornet: unknown weights 'fre'; expected one of: free")
    assert "P2O_WEIGHTS" in line


def test_equal_licences_are_stated_once() -> None:
    pose, licences = np.eye(4), {"extractor": "a", "witness": "a", "cloud": "b"}
    result = p2o.Result(("frame",), pose, pose, p2o.Status.CONVERGED, "", licences=licences)
    assert [text for label, text in result_lines(result) if label == "weights"] == ["a", "b (cloud)"]
