"""All cameras of a rig in one calibration as rows of studies and suites, with known transforms between the cameras."""

from __future__ import annotations

import numpy as np
import p2o
import pytest
from p2o import se3
from p2o.errors import InputError
from p2o_study.cells import Group
from p2o_study.row import Row
from p2o_study.worker import FrameRecord, Plugins, Source

from tests.p2o_study.benchmark_board import SUITE, Board
from tests.study_bench import HEAD, TRUSTED, Bench
from tests.study_plugin import CAMERA, truth_of

RIG = HEAD.replace("frames = 3 }", "frames = 4, cameras = 2 }")
EACH = '[[row]]\nlabel = "each"\njoint = "camera"\ncalibrator = "quick"\nwitness = "none"\n'
ROWS = f'[[row]]\nlabel = "rig"\njoint = "rig"\n{TRUSTED}{EACH}'
OPTIONS = {"pipeline": {"camera": "trust"}}


def stored(bench: Bench, text: str = RIG + ROWS) -> dict[str, list[Row]]:
    rows: dict[str, list[Row]] = {}
    for row in bench.run(text).rows:
        rows.setdefault(row.row, []).append(row)
    return rows


def test_a_row_has_the_pose_of_a_run_and_its_error_which_is_that_of_every_camera(bench: Bench) -> None:
    rows = stored(bench)
    assert [len(row.frames) for row in rows["rig"]] == [4, 4]
    assert [len(row.frames) for row in rows["each"]] == [2, 2, 2, 2]
    # The camera of the first frame is the body.
    places = [truth_of(camera) @ se3.inverse(truth_of(0)) for camera in range(2)]
    for row in rows["rig"]:
        assert row.case.start is not None
        rig = {
            "cameras": {
                name: {"camera_from_body": place.tolist(), "frames": frames}
                for name, place, frames in zip(
                    "ab", places, (["tiny/000", "tiny/002"], ["tiny/001", "tiny/003"]), strict=True
                )
            },
            "body_from_lidar": row.case.start.tolist(),
        }
        run = p2o.calibrate(
            "tiny:?frames=4&cameras=2",
            extractor="tiny/tiny",
            init="given",
            rig=rig,
            options=OPTIONS,
            registry=bench.plugins.registry(),
        )
        assert run.rig is not None
        assert row.estimate is not None
        assert "one calibration of the edges of 2 cameras" in row.reason
        np.testing.assert_allclose(row.estimate, run.rig.body_from_lidar, atol=1e-9)
        assert row.trust == run.rig.verdict.trust
        assert run.rig.accuracy is not None
        assert row.figures["predicted_rotation_deg"] == pytest.approx(run.rig.accuracy.rotation_deg, rel=1e-6)
        for camera, place in enumerate(places):
            error = p2o.pose_error(place @ row.estimate, truth_of(camera))
            errors = row.error_of("rotation_deg"), row.error_of("translation_m")
            assert (error.rotation_deg, error.translation_m) == pytest.approx(errors, abs=1e-6)
        assert row.start_error_of("rotation_deg") == pytest.approx(1.0)
        assert row.error is not None
        assert row.error.rotation_deg < 0.1


def test_a_suite_measures_and_states_rigs_and_external_methods_have_no_poses_of_them(
    board: Board, capsys: pytest.CaptureFixture[str]
) -> None:
    board.write(study=RIG + ROWS, suite=SUITE)
    rows = board.measured()
    assert {(row.row, row.case.rig, row.case.joint, len(row.frames)) for row in rows} == {
        ("rig", True, 4, 4),
        ("each", False, 2, 2),
    }
    assert board.outdated(capsys) == []
    assert board.measured() == []
    starts = board.root / "starts.csv"
    assert board.command("starts", "--out", str(starts)) == 0
    assert [line.count(";") for line in starts.read_text().splitlines()[1:]] == [1] * 10


def record(name: str, **values: object) -> FrameRecord:
    known = {"camera": CAMERA, "camera_from_lidar": truth_of(0), **values}
    return FrameRecord(Source(Plugins(), "d:", "{}", 0, name), {}, **known)  # type: ignore[arg-type]


def test_cameras_have_names_of_their_own_and_need_known_transforms() -> None:
    others = [record(name, camera_name="left", camera_from_lidar=truth_of(n + 1)) for n, name in enumerate("bc")]
    rig = Group((record("a", camera_name="front"), *others), 3, "", rig=True)
    assert list(rig.cameras) == ["front", "left", "c"]
    with pytest.raises(
        InputError, match="b: the transforms between the cameras of the rig are unknown; expected frames with"
    ):
        _ = Group((record("a"), record("b", camera_from_lidar=None)), 2, "", rig=True).cameras
    with pytest.raises(InputError, match="frames of one camera are no rig"):
        _ = Group((record("a"), record("b")), 2, "", rig=True).cameras


def test_a_method_that_raises_on_a_rig_is_one_row(bench: Bench) -> None:
    failing = '[[row]]\nlabel = "rig"\njoint = "rig"\noptions.extractor.fail_on = 3\n'
    [first, _] = stored(bench, RIG + failing)["rig"]
    assert first.status == "stage-failed"
    assert "this picture is not liked" in first.reason
