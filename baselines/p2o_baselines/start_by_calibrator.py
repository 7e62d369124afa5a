"""An initializer that is a calibrator: the pose that all frames determine is the initial guess of the matcher."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import p2o
from p2o import Float


class StartByCalibrator(p2o.InitializerBase):
    """The initializer of a calibrator; `source` names what it evaluates, `hint` is the next step where that fails."""

    def __init__(self, method: p2o.Calibrator, source: str, hint: str) -> None:
        self._method, self._source, self._hint = method, source, hint

    def prepare(self, frame: p2o.Frame) -> Any:
        """Return what the calibrator needs of a frame."""
        return self._method.prepare(frame)

    def __call__(self, views: Sequence[p2o.View], camera_from_lidar: Float) -> list[Float]:
        """Return the pose of the calibrator, one. Raises InputError if it determines none."""
        result = self._method.solve([view.prepared for view in views if view.prepared is not None], camera_from_lidar)
        if not result.status.solved:
            raise p2o.InputError(f"no start from {self._source}: {result.reason}", hint=self._hint)
        return [result.camera_from_lidar]
