"""The outcome of one check: the error of the extrinsic in six axes with its covariance, a verdict, and digests."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from p2o.arrays import Float
from p2o.confidence.audit import AXES

from p2o_fleet.drive import Drive

UPPER = np.triu_indices(len(AXES))
"""Rows and columns of the 21 stored elements of a covariance."""


class Verdict(StrEnum):
    """Outcome of a check: those of `p2o check`, and a log that could not be checked."""

    HOLDS = "holds"
    OFF = "off"
    CANNOT_TELL = "cannot-tell"
    UNREADABLE = "unreadable"


@dataclass(frozen=True, eq=False)
class CheckEvidence:
    """What a check of a drive returns; it contains no image and no point.

    `error` (6,) is the error of the extrinsic in use against the pose of the edges: roll, pitch, yaw in deg and x, y, z
    in m (`p2o.pose_error`), `covariance` (6, 6) its predicted covariance; both None if the edges give no estimate.
    `camera_from_lidar` (4, 4) is the extrinsic, None if it could not be read. `log` is the digest of the content of the
    frames, `extrinsic_digest` that of the extrinsic. `frames` are the names of the frames that were used.
    """

    drive: Drive
    key: str
    verdict: Verdict
    reason: str
    frames: tuple[str, ...] = ()
    error: Float | None = None
    covariance: Float | None = None
    camera_from_lidar: Float | None = None
    odds_ratio: float | None = None
    cells: int = 0
    log: str = ""
    extrinsic_digest: str = ""
    seconds: float = 0.0
    version: str = ""
