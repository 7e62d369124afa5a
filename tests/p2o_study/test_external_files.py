"""Programs outside p2o get their inputs in their own files, and their results are read from them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import p2o
import pytest
import yaml
from p2o import InputError, UnknownNameError, se3
from p2o.cli import main
from p2o_datasets.pcd_file import read_pcd
from p2o_datasets.ply_file import read_ply
from p2o_study.benchmark.external_files import WORDS, Form, files_of, find_form, read_result
from p2o_study.worker import Plugins

from tests.p2o_study.benchmark_board import QUICK_ROW, Board
from tests.pages import ROOT, blocks, shell_blocks
from tests.study_bench import HEAD
from tests.study_plugin import TRUTH

NAMES = ("bevcalib", "calib-anything", "claim", "cmrnext", "direct-visual-lidar", "livox-camera-calib")
# Camera axes: its x is -y of the LiDAR, its y is -z, its z is x. The quaternion x y z w is (1, -1, 1, 1) / 2.
POSE = np.array([[0.0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, 0.3], [0, 0, 0, 1]])
# Its inverse by hand: R' t = (0.3, -0.1, 0.2), and the conjugate quaternion (-1, 1, -1, 1) / 2.
CAMERA = p2o.Camera.pinhole(300.0, 310.0, 7.5, 5.5, 16, 12)


def form(name: str) -> Form:
    return find_form(name, Plugins().registry())


def frame(number: int, camera: p2o.Camera = CAMERA) -> p2o.Frame:
    rng = np.random.default_rng(number)
    xyz, intensity = np.array([[4.0, 1, 0], [0.5, 0, 0], [0, 3, 0], [9, 0, 1]]), np.array([5.0, 7, 1, 3])
    rgb = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
    cloud = p2o.Cloud(xyz, intensity=intensity)
    return p2o.Frame("../../../evil", p2o.Image(rgb, camera), cloud, camera_from_lidar=np.eye(4))


def written(name: str, folder: Path, count: int = 1) -> dict[str, bytes]:
    """Return the inputs of a program by their paths inside the folder."""
    inputs = files_of([frame(number) for number in range(count)], POSE, form(name), folder)
    return {path.relative_to(folder).as_posix(): data for path, data in inputs}


# ---- the start that each program reads, by hand from its documents


def test_cmrnext_reads_the_pose_of_the_lidar_in_the_camera_as_16_numbers(tmp_path: Path) -> None:
    files = written("cmrnext", tmp_path, 2)
    assert {"camera/000001.png", "lidar/000001.pcd"} < set(files)
    tree = yaml.safe_load(files["calibration.yaml"])
    assert tree == {"fx": 300.0, "fy": 310.0, "cx": 7.5, "cy": 5.5, "initial_extrinsic": POSE.ravel().tolist()}


def test_bevcalib_reads_a_sequence_of_kitti_whose_second_camera_is_the_first(tmp_path: Path) -> None:
    files = written("bevcalib", tmp_path)
    lines = dict(line.split(": ") for line in files["sequences/00/calib.txt"].decode().splitlines())
    assert np.allclose(np.array(lines["Tr"].split(), float).reshape(3, 4), POSE[:3], atol=0)
    projection = np.array(lines["P2"].split(), float).reshape(3, 4)
    assert projection.tolist() == [[300, 0, 7.5, 0], [0, 310, 5.5, 0], [0, 0, 1, 0]]
    assert len(files["sequences/00/velodyne/000000.bin"]) == 4 * 4 * 4
    assert "sequences/00/image_2/000000.png" in files


def test_claim_reads_a_translation_and_a_quaternion_with_the_scalar_first(tmp_path: Path) -> None:
    tree = json.loads(written("claim", tmp_path, 3)["config.json"])
    assert tree["extrinsics"] == {"translation": [0.1, -0.2, 0.3], "rotation": [0.5, 0.5, -0.5, 0.5]}
    assert tree["intrinsics"]["K"] == [300.0, 310.0, 7.5, 5.5]
    assert (tree["base_dir"], tree["frame_nums_per_batch"]) == (tmp_path.as_posix(), 3)


def test_direct_visual_lidar_reads_the_inverse_and_equalised_images_and_intensities(tmp_path: Path) -> None:
    files = written("direct-visual-lidar", tmp_path, 2)
    tree = json.loads(files["calib.json"])
    assert tree["results"]["init_T_lidar_camera"] == [-0.3, 0.1, -0.2, -0.5, 0.5, -0.5, 0.5]
    assert tree["meta"]["bag_names"] == ["frame0000", "frame0001"]
    assert cv2.imdecode(np.frombuffer(files["frame0000.png"], np.uint8), cv2.IMREAD_UNCHANGED).shape == (12, 16)
    # The point at half a metre is left out; the others have the intensities 5, 1 and 3: floor(256 rank / 3) / 256.
    cloud = read_ply(files["frame0000.ply"], tmp_path)
    assert np.asarray(cloud["intensity"]).tolist() == [170 / 256, 0, 85 / 256]


def test_livox_camera_calib_reads_an_opencv_matrix_and_numbered_files(tmp_path: Path) -> None:
    files = written("livox-camera-calib", tmp_path, 2)
    assert {"image/0.bmp", "image/1.bmp", "pcd/0.pcd", "pcd/1.pcd"} < set(files)
    tree = yaml.safe_load(files["multi_calib.yaml"])
    assert tree["common"]["image_path"] == f"{tmp_path.as_posix()}/image/"
    assert tree["common"]["data_num"] == 2
    assert tree["camera"]["camera_matrix"] == [300.0, 0.0, 7.5, 0.0, 310.0, 5.5, 0.0, 0.0, 1.0]
    (tmp_path / "config.yaml").write_bytes(files["config.yaml"])
    stored = cv2.FileStorage(str(tmp_path / "config.yaml"), cv2.FILE_STORAGE_READ)
    assert np.array_equal(stored.getNode("ExtrinsicMat").mat(), POSE)
    assert stored.getNode("Voxel.size").real() == 1.0


def test_calib_anything_reads_rows_of_a_matrix(tmp_path: Path) -> None:
    tree = json.loads(written("calib-anything", tmp_path, 2)["calib.json"])
    assert tree["T_lidar_to_cam"] == {"rows": 4, "cols": 4, "data": POSE.tolist()}
    assert tree["cam_K"]["data"] == [[300, 0, 7.5], [0, 310, 5.5], [0, 0, 1]]
    assert tree["file_name"] == ["000000", "000001"]
    assert tree["T_lidar_to_cam_gt"] == {"available": False}


@pytest.mark.parametrize("name", NAMES)
def test_images_and_sweeps_are_those_of_the_frame(name: str, tmp_path: Path) -> None:
    files, source = written(name, tmp_path), form(name)
    if not source.grey_equalised:
        image = cv2.imdecode(np.frombuffer(files[source.image % 0], np.uint8), cv2.IMREAD_COLOR)
        assert np.array_equal(image[..., ::-1], frame(0).image.rgb)
    data = files[source.cloud % 0]
    if source.cloud.endswith(".bin"):
        xyz = np.frombuffer(data, "<f4").reshape(-1, 4)[:, :3]
    else:
        read = read_pcd if source.cloud.endswith(".pcd") else read_ply
        table = read(data, tmp_path)
        xyz = np.column_stack([table[axis] for axis in "xyz"])
    expected = frame(0).cloud.xyz
    assert np.array_equal(xyz, expected[np.linalg.norm(expected, axis=1) >= source.near_m])


@pytest.mark.parametrize("name", NAMES)
def test_inputs_stay_in_their_folder_whatever_frames_are_called_and_hold_no_truth(name: str, tmp_path: Path) -> None:
    for path, data in files_of([frame(0)], POSE, form(name), tmp_path):
        assert path.resolve().is_relative_to(tmp_path.resolve())
        assert b"evil" not in data


def test_a_lens_is_taken_out_of_images(tmp_path: Path) -> None:
    lens = p2o.Camera("OPENCV", 16, 12, (300.0, 300.0, 7.5, 5.5, 0.3, 0.0, 0.0, 0.0))
    inputs = {path.name: data for path, data in files_of([frame(0, lens)], POSE, form("cmrnext"), tmp_path)}
    tree = yaml.safe_load(inputs["calibration.yaml"])
    assert tree["fx"] == pytest.approx(300)
    assert (tree["cx"], tree["cy"]) == (7.5, 5.5)


def test_frames_of_different_cameras_are_refused(tmp_path: Path) -> None:
    other = p2o.Camera.pinhole(200.0, 200.0, 7.5, 5.5, 16, 12)
    with pytest.raises(InputError, match="different cameras"):
        list(files_of([frame(0), frame(1, other)], POSE, form("claim"), tmp_path))


# ---- results, each written by hand as the program writes them


def rows(pose: Any, form_: str = "{:g}") -> list[list[str]]:
    return [[form_.format(value) for value in row] for row in pose]


def tensor(pose: Any) -> str:
    inner = ",\n        ".join(f"[{', '.join(row)}]" for row in rows(pose, "{: .4f}"))
    return f"tensor([{inner}])"


def cmrnext_output(pose: Any) -> str:
    return f"7\nNetwork Time:  tensor(0.1)\nPredicted extrinsic calibration:\n{tensor(pose)}\n"


def livox_output(pose: Any) -> str:
    return "".join(",".join(row) + "\n" for row in rows(pose))


def savetxt(pose: Any) -> str:
    return "".join(" ".join(row) + "\n" for row in rows(se3.inverse(pose), "{:.18e}"))


def calib_anything_output(pose: Any) -> str:
    inner = "],\n[".join(",".join(row) for row in rows(pose))
    return f"Estimate extrinsic Matrix: \n[[{inner}]]\n"


def claim_output(pose: Any) -> str:
    entry = {"frame_id": ["00000"], "T_init": np.eye(4).tolist(), "T_est": np.asarray(pose).tolist()}
    return json.dumps([entry])


def koide_output(pose: Any) -> str:
    from scipy.spatial.transform import Rotation

    inverse = se3.inverse(np.asarray(pose))
    values = [*inverse[:3, 3], *Rotation.from_matrix(inverse[:3, :3]).as_quat()]
    return json.dumps({"results": {"init_T_lidar_camera": [0, 0, 0, 0, 0, 0, 1], "T_lidar_camera": values}})


OUTPUTS: dict[str, Callable[[Any], str]] = {
    "bevcalib": savetxt,
    "calib-anything": calib_anything_output,
    "claim": claim_output,
    "cmrnext": cmrnext_output,
    "direct-visual-lidar": koide_output,
    "livox-camera-calib": livox_output,
}


def put(folder: Path, name: str, text: str) -> Path:
    path = folder / form(name).result.path
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "text"),
    [
        *((name, output(POSE)) for name, output in OUTPUTS.items()),
        ("direct-visual-lidar", '{"results": {"T_lidar_camera": [-0.3, 0.1, -0.2, -0.5, 0.5, -0.5, 0.5]}}'),
        ("livox-camera-calib", "0,-1,0,0.1\n0,0,-1,-0.2\n1,0,0,0.3\n0,0,0,1\n"),
        ("bevcalib", "0 0 1 -0.3\n-1 0 0 0.1\n0 -1 0 -0.2\n0 0 0 1\n"),
        (
            "cmrnext",
            "Predicted extrinsic calibration using average aggregation:\n"
            f"{tensor(np.eye(4))}\nPredicted extrinsic calibration using median aggregation:\n{tensor(POSE)}\n"
            f"Predicted extrinsic calibration using mode aggregation:\n{tensor(np.eye(4))}\n",
        ),
        ("cmrnext", f"Predicted extrinsic calibration:\n{tensor(POSE)[:-1]}, dtype=torch.float64)\n"),
    ],
)
def test_a_result_is_the_pose_of_the_lidar_in_the_camera(name: str, text: str, tmp_path: Path) -> None:
    put(tmp_path, name, text)
    pose = read_result(tmp_path, form(name).result)
    assert pose is not None
    assert np.allclose(pose, POSE, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_an_empty_result_is_a_refused_calibration_and_a_missing_one_an_error(name: str, tmp_path: Path) -> None:
    path = put(tmp_path, name, "")
    assert read_result(tmp_path, form(name).result) is None
    path.unlink()
    with pytest.raises(InputError, match="the result is missing"):
        read_result(tmp_path, form(name).result)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cmrnext", "Traceback (most recent call last)\n", "the result has no pose"),
        ("cmrnext", "Predicted extrinsic calibration:\ntensor([[1., 0.], [0., 1.]])", "the pose is not a pose"),
        ("livox-camera-calib", "0,-1,0,0.1\n0,0,-1,nan\n", "the pose is not a pose"),
        ("livox-camera-calib", livox_output(2 * POSE), "the pose"),
        ("bevcalib", "1 2 3\n", "the pose is not a pose"),
        ("claim", "[]", "0.T_est is not a pose"),
        ("claim", '[{"T_init": []}]', "0.T_est is not a pose"),
        ("claim", f"[{claim_output(POSE)[1:-1]}, {claim_output(POSE)[1:-1]}]", "0.T_est is not a pose"),
        ("claim", "{", "not JSON"),
        ("direct-visual-lidar", '{"results": {"init_T_lidar_camera": [0, 0, 0, 0, 0, 0, 1]}}', "is not a pose"),
        ("direct-visual-lidar", '{"results": {"T_lidar_camera": [0, 0, 0, 0, 0, 0]}}', "is not a pose"),
        ("direct-visual-lidar", '{"results": {"T_lidar_camera": [0, 0, 0, 1, 1, 1, 1]}}', "is not a rotation"),
        ("calib-anything", "[[1,0,0,0]]", "the result has no pose"),
    ],
)
def test_a_result_in_another_format_is_refused(name: str, text: str, message: str, tmp_path: Path) -> None:
    put(tmp_path, name, text)
    with pytest.raises(InputError, match=re.escape(message)) as refused:
        read_result(tmp_path, form(name).result)
    assert "\n" not in str(refused.value)
    assert str(tmp_path) in str(refused.value)


def test_a_link_out_of_the_folder_is_not_followed(tmp_path: Path) -> None:
    inside = tmp_path / "0000"
    inside.mkdir()
    (tmp_path / "other.txt").write_text(livox_output(POSE))
    (inside / "extrinsic.txt").symlink_to(tmp_path / "other.txt")
    with pytest.raises(InputError, match="link out of its folder"):
        read_result(inside, form("livox-camera-calib").result)


# ---- forms


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('path = "calibration.yaml"', 'path = "../calibration.yaml"', "a path inside the folder"),
        ('path = "calibration.yaml"', 'path = "/etc/calibration.yaml"', "a path inside the folder"),
        ('path = "output.txt"', 'path = "a/../../b"', "a path inside the folder"),
        ("camera/%06d.png", "camera/%s.png", "a path with the number of the frame"),
        ("camera/%06d.png", "camera/%06d.gif", "a path with the number of the frame"),
        ("$numbers", "$pose", r"a text with \$count"),
        ('order = "matrix"', 'order = "wxyz"', "order"),
        ("joint = true", "together = true", "unknown key 'together'"),
    ],
)
def test_a_form_that_is_not_valid_is_refused(old: str, new: str, message: str, tmp_path: Path) -> None:
    text = (ROOT / "baselines/p2o_baselines/external/cmrnext.toml").read_text()
    assert old in text
    (tmp_path / "own.toml").write_text(text)
    assert find_form(str(tmp_path / "own.toml"), Plugins().registry()) == form("cmrnext")
    (tmp_path / "own.toml").write_text(text.replace(old, new))
    with pytest.raises((InputError, UnknownNameError), match=message):
        find_form(str(tmp_path / "own.toml"), Plugins().registry())


def test_an_unknown_program_is_refused_with_those_that_are_known() -> None:
    with pytest.raises(UnknownNameError, match=r"unknown form of an external program 'claims'.*claim"):
        form("claims")


# ---- the commands, from the starts of a suite to its rows


@pytest.mark.parametrize("name", NAMES)
def test_the_truth_as_the_result_of_a_program_has_no_error(
    board: Board, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = board.root / "inputs"
    assert board.command("starts", "--for", name, "--out", str(out)) == 0
    assert f"wrote {out}: 15 folders; in each of them run: " in capsys.readouterr().out
    for folder in (path for path in out.iterdir() if path.is_dir()):
        put(folder, name, OUTPUTS[name](TRUTH))
    assert board.command("score", str(out), "--from", name, "--name", name) == 0
    measured = [row for row in board.rows() if row.row == name]
    assert len(measured) == 15
    # PyTorch prints four decimals, C++ six digits.
    rotation_deg = {"cmrnext": 1e-2, "livox-camera-calib": 1e-4, "calib-anything": 1e-4}.get(name, 1e-6)
    for row in measured:
        assert row.error is not None
        assert row.error.rotation_deg < rotation_deg
        assert row.error.translation_m < rotation_deg / 50


def test_wrong_results_end_with_exit_status_2_and_add_nothing(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    out = board.root / "inputs"
    assert board.command("starts", "--for", "claim", "--out", str(out)) == 0
    for pose, seventh, message in (
        (TRUTH, "[]", "0007/results/results.json: 0.T_est is not a pose; expected 3 or 4 rows of 4 numbers; got []"),
        (se3.inverse(TRUTH), None, "most poses are near their initial guess only when inverted"),
    ):
        for number in range(15):
            put(out / f"{number:04d}", "claim", claim_output(pose))
        put(out / "0007", "claim", seventh or claim_output(pose))
        capsys.readouterr()
        assert board.command("score", str(out), "--from", "claim", "--name", "CLAIM") == 2
        [line] = capsys.readouterr().err.splitlines()
        assert message in line
        assert board.rows() == []
    assert board.command("starts", "--for", "claim", "--out", str(out)) == 2
    assert "the folder is not empty" in capsys.readouterr().err, "old results may be in it"


def test_a_program_for_single_frames_takes_one_section(board: Board, capsys: pytest.CaptureFixture[str]) -> None:
    row = QUICK_ROW.replace("witness", 'section = "{0}"\n{1}witness').replace('label = "quick"', 'label = "{0}"')
    board.write(study=HEAD + row.format("single", "") + row.format("together", "joint = true\n"))
    out = board.root / "inputs"
    assert board.command("starts", "--for", "bevcalib", "--out", str(out)) == 2
    assert "tiny: tiny/000 +2: BEVCalib calibrates single frames; got 5 joint calibrations" in capsys.readouterr().err
    assert not any(out.iterdir())
    assert board.command("starts", "--for", "bevcalib", "--out", str(out), "--section", "single") == 0
    for number in range(15):
        put(out / f"{number:04d}", "bevcalib", savetxt(TRUTH))
    words = ("--from", "bevcalib", "--name", "BEVCalib", "--section", "single")
    assert board.command("score", str(out), *words) == 0
    assert {(row.section, row.case.joint) for row in board.rows()} == {("single", 0)}
    assert board.command("starts", "--out", str(board.root / "s.csv"), "--section", "triple") == 2
    assert "unknown section 'triple'" in capsys.readouterr().err


# ---- the page published-network, away from the source tree


PAGE = "docs/how-to/published-network.md"


def test_the_form_of_the_page_is_valid(tmp_path: Path) -> None:
    [toml] = [block.text for block in blocks(PAGE) if block.language == "toml"]
    (tmp_path / "mine.toml").write_text(toml)
    own = find_form(str(tmp_path / "mine.toml"), Plugins().registry())
    inputs = {path.name: data for path, data in files_of([frame(0)], POSE, own, tmp_path)}
    assert json.loads(inputs["config.json"])["init"] == se3.inverse(POSE).tolist()
    (tmp_path / "result.json").write_text('{"poses": [[-0.3, 0.1, -0.2, 0.5, -0.5, 0.5, -0.5]]}')
    pose = read_result(tmp_path, own.result)
    assert pose is not None
    assert np.allclose(pose, POSE, rtol=0, atol=1e-12)


def test_the_page_names_every_program_and_every_word() -> None:
    text = (ROOT / PAGE).read_text()
    assert all(f"| `{name}` |" in text for name in NAMES)
    assert all(f"${word}`" in text for word in WORDS)


@pytest.mark.system
def test_the_shell_lines_of_the_page_run_in_an_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [command.words[1:] for block in shell_blocks(PAGE) for command in block.commands()]
    assert len(lines) == 4
    for words in lines:
        if "--from" in words:
            for folder in (tmp_path / "inputs").glob("0*"):
                put(folder, "cmrnext", cmrnext_output(POSE))
        assert main(words) == 0, capsys.readouterr().err
    table = capsys.readouterr().out
    assert "| CMRNext |" in table
    assert "| initial guess |" in table
