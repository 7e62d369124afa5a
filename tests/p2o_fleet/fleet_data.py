"""Drives, evidence and stores of a small fleet, without images."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from p2o.arrays import Float
from p2o_fleet.drive import Drive
from p2o_fleet.evidence import CheckEvidence, Verdict
from p2o_fleet.schema import row_of
from p2o_fleet.store import Store

BEGIN = 1767225600.0  # 2026-01-01
SIGMA = np.array([0.06, 0.1, 0.06, 0.01, 0.015, 0.01])
POSE = np.array([[0.0, -1, 0, 0.02], [0, 0, -1, -0.1], [1, 0, 0, -0.3], [0, 0, 0, 1]])


def drive(vehicle: str = "a", number: int = 0, **changes: object) -> Drive:
    time = BEGIN + 8640.0 * number
    plain = Drive(vehicle, "front", "top", f"folder:{vehicle}/{number}", "extrinsic.yaml", time, "van")
    return replace(plain, **changes)  # type: ignore[arg-type]


def evidence(of: Drive, error: Float | None = None, **changes: object) -> CheckEvidence:
    size = np.zeros(6) if error is None else error
    plain = CheckEvidence(
        of,
        of.key(),
        Verdict.HOLDS,
        "no axis is off by more than its limit",
        ("0", "1", "2", "3", "4", "5", "6", "7"),
        size,
        np.diag(SIGMA**2),
        POSE,
        10.0,
        200,
        f"log of {of.data}",
        "digest",
        4.0,
        "0.1",
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


def filled(store: Store, vehicle: str, errors: Float, **changes: object) -> None:
    """Store one check for each error (T, 6) of a vehicle."""
    store.journals.mkdir(parents=True, exist_ok=True)
    store.add(row_of(evidence(drive(vehicle, at, **changes), error)) for at, error in enumerate(errors))
