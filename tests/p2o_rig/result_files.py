"""Files of results as `p2o run --json` writes them, with the poses of a random rig."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from p2o import Float, Result, Status, se3
from p2o.results.evidence import Accuracy
from p2o.results.result_json import result_to_dict
from p2o.results.verdict import Doubt, Reason, Verdict

TOO_UNSURE = Verdict((Reason(Doubt.TOO_UNSURE, "the predicted error is large"),))


def result(pose: Float, covariance: Float | None, verdict: Verdict | None = None, **more: Any) -> Result:
    """Return a solved result whose predicted error is that of its covariance."""
    accuracy = Accuracy(0.2, 0.05, 0.44, 0.11) if covariance is not None and np.isfinite(covariance).all() else None
    words: dict[str, Any] = {"status": Status.CONVERGED, "reason": "converged", "accuracy": accuracy, **more}
    return Result(("frame",), np.eye(4), pose, covariance=covariance, verdict=verdict or Verdict(), **words)


COVARIANCE = np.diag(np.repeat([np.radians(0.1), 0.03], 3) ** 2)


def exact(truth: dict[str, Float], camera: str, lidar: str, **more: Any) -> Result:
    """Return the result with the true pose of a LiDAR in a camera."""
    return result(se3.inverse(truth[camera]) @ truth[lidar], COVARIANCE, **more)


def write_results(path: Path, rows: Iterable[tuple[str, Result]]) -> Path:
    content = [{"camera": camera, **result_to_dict(row), "error": None, "start_error": None} for camera, row in rows]
    path.write_text(json.dumps({"results": content, "failed": [], "summary": {}}), encoding="utf-8")
    return path


def write_sensors(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")  # YAML contains JSON
    return path
