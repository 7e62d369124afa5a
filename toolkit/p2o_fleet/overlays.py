"""Overlays of the frames that prove an alarm: the sweep at the extrinsic in use and at the proposed one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from p2o.draw.image_uri import jpeg_uri
from p2o.draw.overlay import draw_cloud
from p2o.errors import P2OError
from p2o.frames.selection import spread
from p2o.host.registry import Registry
from p2o.run.check import given_extrinsic
from p2o.run.recipe import open_dataset

from p2o_fleet.fetch import local_data
from p2o_fleet.fleet_state import ExtrinsicState

_FRAMES, _MOST = 2, 20


@dataclass
class Overlays:
    """Draws overlays of up to 20 alarms whose logs this machine can read; counts those drawn."""

    registry: Registry
    drawn: int = 0

    def of(self, state: ExtrinsicState) -> list[dict[str, str]]:
        """Return frames of the last log of an alarm, as data URIs in use and proposed; empty without a log."""
        alarm = state.alarm
        if alarm is None or not alarm.proof or self.drawn >= _MOST:
            return []
        try:
            with local_data(alarm.proof[-1]) as data:
                dataset = open_dataset(data, self.registry)
                frames = [dataset[index] for index in spread(range(len(dataset)), _FRAMES)]
                in_use = given_extrinsic(state.extrinsic, frames, self.registry, "extrinsic").camera_from_lidar
                shown = []
                for frame in frames:
                    images = (
                        draw_cloud(np.asarray(frame.image.rgb), frame.cloud, frame.camera, pose)
                        for pose in (in_use, alarm.proposal)
                    )
                    before, after = map(jpeg_uri, images)
                    shown.append({"name": frame.name, "log": alarm.proof[-1], "before": before, "after": after})
        except (P2OError, OSError, ValueError):
            return []
        self.drawn += 1
        return shown
