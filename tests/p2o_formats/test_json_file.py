"""The exporter `json` writes a file that reads back to the same result."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from p2o import InputError, Result, Status, se3
from p2o.results.result_json import result_from_json, result_to_dict
from p2o_formats.result_file import EXPORTER as METHOD

RESULT = Result(
    frames=("scène-0000",),
    start=np.eye(4),
    camera_from_lidar=se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])),
    status=Status.CONVERGED,
    reason="done",
)


@pytest.mark.parametrize("before", ["", "x" * 100_000])
def test_the_file_reads_back_to_the_same_result_whatever_was_there(tmp_path: Path, before: str) -> None:
    path = tmp_path / "result.json"
    path.write_text(before)
    METHOD.build(METHOD.options())(RESULT, path)
    again = result_from_json(path.read_text(encoding="utf-8"))
    assert result_to_dict(again) == result_to_dict(RESULT)
    assert again.camera_from_lidar.tobytes() == RESULT.camera_from_lidar.tobytes()
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_that_is_missing_or_a_file_is_an_error_of_ours(tmp_path: Path) -> None:
    export = METHOD.build(METHOD.options())
    with pytest.raises(InputError, match=r"nowhere.*cannot write the file.*create the folder first"):
        export(RESULT, tmp_path / "nowhere" / "result.json")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write the file"):
        export(RESULT, tmp_path / "file" / "result.json")
    with pytest.raises(InputError, match="name a file, not a folder"):
        export(RESULT, tmp_path)
