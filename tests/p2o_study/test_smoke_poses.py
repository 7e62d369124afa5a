"""A change that moves poses of the study `smoke` raises `p2o.ALGORITHM`: its poses are compared with stored ones.

    python -m tests.p2o_study.test_smoke_poses

writes the stored poses again, after ALGORITHM was raised or plugins were changed.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import p2o
import pytest
from p2o.cache import content_hash
from p2o.run.run import run
from p2o_study.keys import method_content
from p2o_study.study import StudyRow, check_study, find_study

STORED = Path(__file__).with_name("smoke_poses.json")
WRITE = "python -m tests.p2o_study.test_smoke_poses"
MAX_MOVED = 1e-6
"""Largest difference of an entry of a pose (rad, m)."""
ROWS = ("ogm", "ogm-lr", "nearest", "ogm, joint", "ogm, search")
LIBRARIES = ("numpy", "scipy", "opencv-contrib-python-headless")
"""Packages whose other versions may move poses; they are part of the key of a row."""


@cache
def study_rows() -> dict[str, StudyRow]:
    registry = p2o.Registry.load(environ={})
    rows = check_study(find_study("smoke", registry), registry)
    return {row.label: row for row in rows}


def computed(label: str) -> dict[str, Any]:
    """Return revision of the methods, versions, and by frames the digest of their arrays, pose and verdict."""
    plan = study_rows()[label].resolve(p2o.Registry.load(environ={}), 0)
    frames = {frame.name: content_hash([frame.image, frame.cloud]) for frame in plan.dataset()}
    done = run(plan)
    methods = [method_content(part) for stage, part in sorted(plan.parts.items()) if stage != "data"]
    return {
        "methods": content_hash(methods),
        "versions": {name: version for name, version in plan.versions().items() if name in LIBRARIES},
        "cells": {
            " ".join(row.result.frames): {
                "frames": [frames[name] for name in row.result.frames],
                "pose": row.result.camera_from_lidar.tolist(),
                "trust": row.result.verdict.trust,
            }
            for row in done.rows
        },
    }


def check(known: dict[str, Any], algorithm: int, now: dict[str, Any]) -> None:
    """Fail where poses moved without a raised version; skip what other frames or libraries may have moved."""
    assert algorithm == p2o.ALGORITHM, f"p2o.ALGORITHM was raised: store the new poses with {WRITE}"
    if known["versions"] != now["versions"]:
        pytest.skip("other versions of libraries")
    same = [name for name, cell in now["cells"].items() if cell["frames"] == known["cells"][name]["frames"]]
    if not same:
        pytest.skip("the arrays of all frames differ on this processor")
    for name in same:
        old, new = known["cells"][name], now["cells"][name]
        moved = float(np.abs(np.subtract(old["pose"], new["pose"])).max())
        if moved > MAX_MOVED or old["trust"] != new["trust"]:
            what = f"the pose of {name} moved by {moved:.2g}, verdict {old['trust']} is now {new['trust']}"
            if known["methods"] != now["methods"]:
                pytest.fail(f"{what}: the code of its methods was changed, store the new poses with {WRITE}")
            pytest.fail(f"{what}: raise p2o.ALGORITHM, then {WRITE}; or restore the poses")


@pytest.mark.parametrize("label", ROWS)
def test_poses_are_those_of_the_algorithm_of_this_version(label: str) -> None:
    stored = json.loads(STORED.read_text())
    check(stored["rows"][label], stored["algorithm"], computed(label))


def test_a_moved_pose_is_noticed() -> None:
    stored = json.loads(STORED.read_text())
    known, algorithm = stored["rows"]["ogm"], stored["algorithm"]
    assert set(ROWS) == set(study_rows())

    def changed(**values: Any) -> dict[str, Any]:
        now = json.loads(json.dumps(known))
        cell = now["cells"]["scene-0000"]
        cell["pose"][0][3] += values.pop("moved_m", 0.0)
        cell |= {key: value for key, value in values.items() if key in cell}
        return {**now, **{key: value for key, value in values.items() if key in now}}

    check(known, algorithm, changed(moved_m=0.5e-6))
    for change in ({"moved_m": 2e-6}, {"trust": "unknown"}):
        with pytest.raises(pytest.fail.Exception, match=r"raise p2o\.ALGORITHM"):
            check(known, algorithm, changed(**change))
        with pytest.raises(pytest.fail.Exception, match="code of its methods was changed"):
            check(known, algorithm, changed(**change, methods="other"))
    check(known, algorithm, changed(moved_m=1.0, frames=["other"]))
    with pytest.raises(pytest.skip.Exception):
        check(known, algorithm, changed(moved_m=1.0, versions={}))
    with pytest.raises(AssertionError, match=r"p2o\.ALGORITHM was raised: store the new poses"):
        check(known, algorithm + 1, changed())


if __name__ == "__main__":
    rows = {label: computed(label) for label in ROWS}
    STORED.write_text(json.dumps({"algorithm": p2o.ALGORITHM, "rows": rows}, indent=1) + "\n")
