"""A simulated fleet: measured evidence of real and simulated rigs, resampled, with faults of known size and time."""

from __future__ import annotations

import hashlib
import importlib.resources
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
from p2o.arrays import Float, Int
from p2o.confidence.audit import AXES
from p2o.errors import InputError

from p2o_fleet.checks import Checks
from p2o_fleet.drive import Drive
from p2o_fleet.evidence import Evidence, Verdict, estimate_columns, symmetric, table_of
from p2o_fleet.store import Row, Store

BANK = "noise.json"
_DAY_S = 86400.0
_BEGIN = 1577836800.0
"""Time of the first check of a simulated fleet: 2020-01-01, in s since 1970, so that none is in the future."""
_POSE = (0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.0, -0.1, 1.0, 0.0, 0.0, -0.3)
"""True extrinsic of all simulated vehicles: a camera that looks forward."""
_REASONS = {
    Verdict.CANNOT_TELL: "too few pairs of edges are within reach",
    Verdict.UNREADABLE: "the log cannot be read",
}
_OFFSET = np.repeat([0.05, 0.01], 3)
"""Standard deviations, in deg and m, of the constant errors of vehicles, which are at most three of them."""


class Fault(StrEnum):
    """What is wrong with a simulated vehicle."""

    NONE = "none"
    SLIP = "slip"
    DRIFT = "drift"
    SWAPPED = "swapped-cameras"
    DIRTY = "dirty-lens"
    BROKEN = "broken-logs"
    CLOCK = "clock-error"


@dataclass(frozen=True, eq=False)
class NoiseBank:
    """Measured evidence at correct extrinsics: `groups` are the indices of its rows by rig.

    `centred` (N, 6) are errors in deg and m without the median of their rig, which is the error of its published
    extrinsic; `covariance` (N, 6, 6) and `frame_count` (N,) those of the checks.
    """

    groups: Mapping[str, Int]
    centred: Float
    covariance: Float
    frame_count: Int

    @classmethod
    def shipped(cls) -> NoiseBank:
        """Return the evidence that p2o contains (docs/how-to/fleet.md states how it was measured)."""
        text = importlib.resources.files("p2o_fleet").joinpath(BANK).read_text(encoding="utf-8")
        rows = json.loads(text)["checks"]
        rigs, centred, upper, frames = (
            np.array([row[n] for row in rows]) for n in ("rig", "error", "covariance", "frames")
        )
        groups = {str(rig): np.flatnonzero(rigs == rig) for rig in np.unique(rigs)}
        for own in groups.values():
            # The mean of n values absorbs part of their variance.
            centred[own] = (centred[own] - np.median(centred[own], axis=0)) * np.sqrt(len(own) / max(1, len(own) - 1))
        return cls(groups, centred, symmetric(upper), frames)


@dataclass(frozen=True)
class Scenario:
    """A simulated fleet: `checks` per vehicle, `per_day` of them a day, and the share of vehicles with each fault.

    `rigs` are rigs of the bank whose noise is used; vehicle n has the rig n mod len(rigs), which is its type. Slips and
    drifts are `slip_deg` or `slip_m` on one axis. `wrong_cad_deg` is the error of all vehicles of the first type about
    yaw.
    """

    vehicles: int = 1000
    checks: int = 100
    per_day: float = 10.0
    rigs: tuple[str, ...] = ("sim-hdl-64e", "kitti")
    shares: Mapping[Fault, float] = field(default_factory=dict)
    slip_deg: float = 0.5
    slip_m: float = 0.05
    wrong_cad_deg: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not sum(self.shares.values()) <= 1 + 1e-9:
            raise InputError("the fleet cannot be simulated", expected="shares of at most 1")


@dataclass(frozen=True, eq=False)
class SimulatedVehicle:
    """A vehicle with its fault, the axis and the number of the first check with it; and the rows of its checks."""

    name: str
    fault: Fault
    axis: int
    begin: int
    rows: Sequence[Row]

    @cached_property
    def checks(self) -> Checks:
        """Return the checks as a store returns them."""
        return Checks.of(table_of(self.rows), self.name)


def simulated_fleet(scenario: Scenario, bank: NoiseBank) -> Iterator[SimulatedVehicle]:
    """Yield the vehicles of a scenario, each the same for the same seed."""
    return (_vehicle(scenario, bank, number) for number in range(scenario.vehicles))


def _vehicle(scenario: Scenario, bank: NoiseBank, number: int) -> SimulatedVehicle:
    rng = np.random.default_rng([scenario.seed, number])
    count, rig = scenario.checks, scenario.rigs[number % len(scenario.rigs)]
    faults = list(scenario.shares)
    edges = np.cumsum([scenario.shares[fault] for fault in faults])
    at = int(np.searchsorted(edges, rng.random(), side="right"))
    fault = faults[at] if at < len(faults) else Fault.NONE
    axis, sign = int(rng.integers(len(AXES))), 1 if rng.random() < 0.5 else -1
    size = sign * (scenario.slip_deg if axis < 3 else scenario.slip_m)
    begin = int(rng.integers(count // 5, max(count // 5 + 1, count * 3 // 5)))
    drawn = bank.groups[rig][rng.integers(len(bank.groups[rig]), size=count)]
    error, covariance = bank.centred[drawn].copy(), bank.covariance[drawn].copy()
    error += np.clip(rng.normal(size=6), -3, 3) * _OFFSET
    time = np.asarray(_BEGIN + np.arange(count) * _DAY_S / scenario.per_day, np.float64)
    temperature = 12 - 12 * np.cos(2 * np.pi * (time - _BEGIN) / (365 * _DAY_S)) + rng.normal(size=count) * 3
    if number % len(scenario.rigs) == 0:
        error[:, 2] += scenario.wrong_cad_deg
    verdict = np.full(count, Verdict.HOLDS, dtype=object)
    _inject(fault, error, covariance, verdict, axis, size, begin, rng)
    name = f"vehicle-{number:05d}"
    common: dict[str, Any] = {"cells": 200, "seconds": 6.0, "version": "simulated", "camera_from_lidar": _POSE}
    common |= {"extrinsic_digest": hashlib.sha256(name.encode()).hexdigest()[:32]}
    rows = []
    for at in range(count):
        log, outcome = f"{name}-{at:06d}", verdict[at]
        when, degrees = float(time[at]), float(temperature[at])
        figures = {**common, "frame_count": int(bank.frame_count[drawn[at]])}
        if outcome == Verdict.HOLDS:
            figures |= {**estimate_columns(error[at], covariance[at]), "odds_ratio": 10.0}
        evidence = Evidence(
            drive=Drive(name, "front", "top", log, "extrinsic.yaml", when, rig, temperature_c=degrees),
            key=log,
            verdict=outcome,
            reason=_REASONS.get(outcome, ""),
            log="" if outcome == Verdict.UNREADABLE else log,
            **figures,
        )
        rows.append(evidence.row())
    return SimulatedVehicle(name, fault, axis, begin, rows)


def _inject(
    fault: Fault, error: Float, covariance: Float, verdict: Any, axis: int, size: float, begin: int, rng: Any
) -> None:
    """Change errors (T, 6), covariances and verdicts by a fault."""
    count = len(error)
    if fault is Fault.SLIP:
        error[begin:, axis] += size
    elif fault is Fault.DRIFT:
        error[:, axis] += size * np.linspace(0, 1, count)
    elif fault is Fault.SWAPPED:
        verdict[:] = Verdict.CANNOT_TELL
    elif fault is Fault.DIRTY:
        verdict[begin:][rng.random(count - begin) < 0.7] = Verdict.CANNOT_TELL
        covariance[begin:] *= 4
        error[begin:] += rng.normal(size=(count - begin, 6)) * np.sqrt(np.einsum("tii->ti", covariance[begin:])) * 0.8
    elif fault is Fault.BROKEN:
        verdict[rng.random(count) < 0.3] = Verdict.UNREADABLE
    elif fault is Fault.CLOCK:
        # Image and sweep of different moments: the error follows the yaw rate and the speed of each drive.
        error[:, 2] += rng.normal(size=count) * 0.1
        error[:, 3] += rng.normal(size=count) * 0.01


def write_fleet(vehicles: Iterator[SimulatedVehicle], store: Store) -> int:
    """Write simulated vehicles to a store, as runs do; return the number of checks."""
    total = 0
    for vehicle in vehicles:
        store.add(vehicle.rows)
        total += len(vehicle.rows)
    return total
