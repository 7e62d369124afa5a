"""Drives, evidence and stores of a small fleet, without images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from p2o.arrays import Float
from p2o_fleet.drive import Drive
from p2o_fleet.evidence import Evidence, Verdict, estimate_columns
from p2o_fleet.store import Store

BEGIN = 1767225600.0  # 2026-01-01
SIGMA = np.array([0.06, 0.1, 0.06, 0.01, 0.015, 0.01])
POSE = np.array([[0.0, -1, 0, 0.02], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])


def drive(vehicle: str = "a", number: int = 0, **changes: object) -> Drive:
    time = BEGIN + 8640.0 * number
    plain = Drive(vehicle, "front", "top", f"folder:{vehicle}/{number}", "extrinsic.yaml", time, "van")
    return replace(plain, **changes)  # type: ignore[arg-type]


def evidence(of: Drive, error: Float | None = None, covariance: Float | None = None, **changes: object) -> Evidence:
    """Return the evidence on a drive; with a verdict of no estimate, without one."""
    size, spread = np.zeros(6) if error is None else error, np.diag(SIGMA**2) if covariance is None else covariance
    estimate = {} if "verdict" in changes else estimate_columns(size, spread)
    plain: dict[str, object] = {"verdict": Verdict.HOLDS, "reason": "no axis is off by more than its limit"}
    plain |= {"frames": tuple("01234567"), "frame_count": 8, "camera_from_lidar": tuple(POSE[:3].ravel().tolist())}
    plain |= {"log": f"log of {of.data}", "extrinsic_digest": "digest", **estimate, **changes}
    return Evidence(drive=of, key=of.key(), **plain)  # type: ignore[arg-type]


def filled(store: Store, vehicle: str, errors: Float, **changes: object) -> None:
    """Store one check for each error (T, 6) of a vehicle."""
    store.journals.mkdir(parents=True, exist_ok=True)
    store.add(evidence(drive(vehicle, at, **changes), error).row() for at, error in enumerate(errors))


def noise(seed: int, count: int) -> Float:
    """Return errors (T, 6) of checks without a fault."""
    return np.asarray(np.random.default_rng(seed).normal(size=(count, 6)) * SIGMA)
