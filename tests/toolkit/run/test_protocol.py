"""Protocols: the starts and the figures of publications by name, on the command line, in Python and in studies."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import InputError, UnknownNameError, se3
from p2o.cli import main
from p2o.geometry.perturb import parse_perturbation
from p2o.run.initial_guess import starts_of
from p2o.run.protocol import PROTOCOLS, protocol_of
from p2o_study.study import parse_study
from p2o_study.summary import summarised
from p2o_study.tables import terminal_text

from tests.fake_study import run_of

SMALL = "synthetic:?width_px=310&height_px=94&place=street"


@pytest.mark.parametrize("name", list(PROTOCOLS))
def test_every_protocol_draws_starts_that_can_be_read_and_reports_figures_that_there_are(name: str) -> None:
    protocol = protocol_of(name)
    size = parse_perturbation(protocol.perturb)
    assert str(size) == str(parse_perturbation(str(size)))
    truth = np.eye(4)
    starts = np.stack([size.start(truth, np.random.default_rng([7, i]), i) for i in range(20)])
    figures = protocol.figures(starts, np.repeat(truth[None], 20, axis=0))
    assert set(figures) == {*protocol.metrics, *protocol.limits}
    assert all(np.isfinite(value) for value in figures.values())


def test_names_are_told_and_starts_are_drawn_once() -> None:
    with pytest.raises(UnknownNameError, match="did you mean lccnet-20"):
        protocol_of("lccnet20")
    with pytest.raises(InputError, match="a protocol draws its own starts"):
        starts_of("cmrnext", "1deg")
    assert starts_of("p2o-calib", None) == "2deg 0.15m"
    assert starts_of(None, "1deg") == "1deg"
    # A published list stands beside a protocol where it acts on the same side.
    assert starts_of("projfusion-15-15", "camera @test_13.txt") == "camera @test_13.txt"
    assert starts_of("claim", "@list.txt") == "@list.txt"
    with pytest.raises(InputError, match="act in the camera's frame"):
        starts_of("projfusion-15-15", "@test_13.txt")
    with pytest.raises(InputError, match="act in the LiDAR's frame"):
        starts_of("claim", "camera @list.txt")


def test_a_run_begins_where_the_list_says_whatever_the_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    starts = tmp_path / "starts.csv"
    starts.write_text("name,r1,r2,r3,t1,t2,t3\nscene-0000,0.02,0,0,0,0.05,0\n")
    words = {"extractor": "depth/rings", "init": "given", "options": ["pipeline.min_matches=100000"]}
    for seed in (0, 5):
        done = p2o.calibrate(SMALL, perturb=f"camera @{starts}", protocol="calibvit-10-25", seed=seed, **words)
        error = done.result.start @ se3.inverse(done.rows[0].truth)
        np.testing.assert_allclose(se3.log(error), [0.02, 0, 0, 0, 0.05, 0], atol=1e-12)
        assert done.result.recipe["perturb"] == f"camera @{starts}"
        assert done.summary["protocol"]["euler_deg_x"] == pytest.approx(np.degrees(0.02))
    assert main(["run", "--data", f"{SMALL}&scenes=2", "--extractor", "depth/rings", "--perturb", f"@{starts}"]) == 2
    told = capsys.readouterr()
    assert "frame scene-0001 has no start in the list" in told.err
    assert told.out == "", "told before any frame is calibrated"


def test_the_command_reports_the_figures_of_the_protocol(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["run", "--data", SMALL, "--extractor", "depth/rings", "--init", "given", "--protocol", "projfusion-5-50"]
    assert main([*words, "--json"]) in (0, 1)
    told = json.loads(capsys.readouterr().out)["summary"]["protocol"]
    assert told["name"] == "projfusion-5-50"
    assert told["count"] == 1
    assert {"euler_deg_norm", "shift_m_mean", "l1", "l2"} <= set(told)
    assert main(words) in (0, 1)
    assert "protocol projfusion-5-50: euler_deg_norm" in capsys.readouterr().out
    assert main([*words, "--perturb", "1deg"]) == 2
    assert "--protocol: a protocol draws its own starts" in capsys.readouterr().err


def test_a_refused_calibration_counts_with_its_start() -> None:
    done = p2o.calibrate(SMALL, extractor="depth/rings", protocol="p2o-calib", options=["pipeline.min_matches=100000"])
    assert not done.solved
    assert done.summary["protocol"]["rotation_deg_mean"] == pytest.approx(2.0)
    assert done.summary["protocol"]["translation_m_mean"] == pytest.approx(0.15)


def test_a_study_draws_the_starts_of_its_protocol_and_tells_its_figures_below_the_table() -> None:
    text = """
    name = "s"
    title = "S"
    protocol = "borer-2"
    [[dataset]]
    name = "d"
    data = "synthetic:"
    [[row]]
    label = "ours"
    """
    study = parse_study(text)
    [row] = study.rows()
    assert row.words["perturb"] == "fibonacci 2deg"
    rows = [run_of("ours", "a", 0, 0.2, 0.1), run_of("ours", "b", 0, 0.9, 0.1)]
    line = "ours: protocol borer-2: rotation_deg_mean 0.550, rotation_deg_median 0.550, hit_rate 50 %"
    assert line in terminal_text(summarised(study, rows))
    with pytest.raises(UnknownNameError, match="protocol"):
        parse_study(text.replace("borer-2", "borer-3")).rows()
    with pytest.raises(InputError, match="study s, protocol: a protocol draws its own starts"):
        parse_study(text.replace('"borer-2"', '"borer-2"\nperturb = "1deg"')).rows()
