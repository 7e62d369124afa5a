"""Resampled fleets: how soon `p2o fleet` finds slips, drifts and wrong nominal extrinsics, and how often it is wrong.

Each check is one of the measured checks of `p2o_fleet/noise.json`, drawn at random, plus a constant error of the
vehicle and its fault. `python benchmarks/fleet.py detect` prints the tables.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from limits_and_tables import table
from p2o.arrays import Bool, Float, Int
from p2o.confidence.audit import AXES
from p2o_fleet.fleet_state import FleetRules
from p2o_fleet.noise import PairNoise
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, SimulatedVehicle, simulated_fleet
from p2o_fleet.statistics import discoveries, e_process, local_deviations, noise_scale, systematic

RIGS = ("kitti", "sim-hdl-64e")
RATE, TOLERANCE = 0.01, FleetRules().sizes("tolerance")
WITHIN = 200
_SAMPLED_VEHICLES = 100
_LONG = 8
"""The fleets without a fault and with drifts have the number of checks times this factor."""


def detect(vehicles: int = 1000, checks: int = 125, fleets: int = 100) -> Iterator[str]:
    """Yield tables of the noise, of faults and false alarms of single vehicles, and of errors of a type."""
    bank, lines = NoiseBank.shipped(), []
    for rig in RIGS:
        rows = bank.groups[rig]
        sigma = bank.centred[rows].std(axis=0)
        turn, shift = (", ".join(f"{value:.2f}" for value in part) for part in (sigma[:3], 100 * sigma[3:]))
        lines.append((f"`{rig}`", len(rows), bank.frame_count[rows].sum(), turn, shift))
    yield table(("noise", "checks", "frames", "sd of roll, pitch, yaw (deg)", "sd of x, y, z (cm)"), lines)
    faults = [
        (f"`{rig}`", name, *_detected(scenario, bank))
        for rig in RIGS
        for name, scenario in _scenarios(rig, vehicles, checks).items()
    ]
    head = ("noise", "faults", "frames", f"found within {WITHIN} frames", "found", "frames: median, 95 %", "error")
    yield table((*head, "right axis", "false alarms"), faults)
    yield _types(fleets, bank)


def _scenarios(rig: str, vehicles: int, checks: int) -> dict[str, Scenario]:
    """Return the fleets of a rig; in each, a tenth of the vehicles have the first fault."""
    plain = Scenario(vehicles, checks, 10.0, (rig,), {Fault.SLIP: 0.1})
    others = dict.fromkeys((Fault.DRIFT, Fault.SWAPPED, Fault.DIRTY, Fault.BROKEN, Fault.CLOCK), 0.02)
    long = replace(plain, checks=_LONG * checks)
    return {
        "none": replace(long, shares={}),
        "slip 0.5 deg, 5 cm": plain,
        "slip 0.3 deg, 3 cm": replace(plain, slip_deg=0.3, slip_m=0.03),
        "slip 0.2 deg, 2 cm": replace(plain, slip_deg=0.2, slip_m=0.02),
        "slip 0.5 deg, 5 cm, others": replace(plain, shares={**plain.shares, **others}),
        f"drift 0.5 deg, 5 cm in {long.checks / long.per_day:.0f} days": replace(long, shares={Fault.DRIFT: 0.1}),
    }


@dataclass(frozen=True, eq=False)
class _Judged:
    """A vehicle, the check `begin` with which its fault begins, the frames (T + 1,) before each of its checks.

    `axes` (T,) are the axes of the strongest evidence after each check.
    """

    vehicle: SimulatedVehicle
    begin: int
    frames: Int
    axes: Int

    def detected_after(self, alarms: Bool) -> int | None:
        """Return the check after which the fault is found, by the alarms (T,) after each check."""
        first = np.flatnonzero(alarms[self.begin :])
        return self.begin + int(first[0]) if len(first) else None


def _detected(scenario: Scenario, bank: NoiseBank) -> list[str]:
    """Return the columns of a fleet; its alarms are evaluated after every check."""
    noise = noise_of(list(itertools.islice(simulated_fleet(scenario, bank), _SAMPLED_VEHICLES)))
    fleet, total = list[_Judged](), np.zeros((scenario.vehicles, scenario.checks))
    for vehicle in simulated_fleet(scenario, bank):
        logs = logs_of(vehicle, noise)
        total[len(fleet)] = np.logaddexp.reduce(logs, axis=1) - np.log(len(AXES))
        frames = np.concatenate([[0], np.cumsum(vehicle.checks.frame_count)])
        begin = {Fault.SLIP: vehicle.begin, Fault.DRIFT: 0}.get(vehicle.fault, scenario.checks)
        fleet.append(_Judged(replace(vehicle, rows=()), begin, frames, logs.argmax(axis=1)))
    rejected = np.stack([discoveries(column, RATE) for column in total.T], axis=1)
    fault = next(iter(scenario.shares), None)
    delays, right, at, false = list[float](), 0, list[float](), Counter[str]()
    for each, alarms in zip(fleet, rejected, strict=True):
        false[each.vehicle.fault.value] += bool(alarms[: each.begin].any())
        if each.vehicle.fault is fault:
            last = each.detected_after(alarms)
            delays.append(np.inf if last is None else float(each.frames[last + 1] - each.frames[each.begin]))
            if last is not None:
                right += int(each.axes[last]) == each.vehicle.axis
                at.append((last + 1) / scenario.checks if fault is Fault.DRIFT else 1.0)
    frames = f"{sum(int(each.frames[-1]) for each in fleet):,}"
    wrong = ", ".join(f"{number} ({name})" for name, number in false.items() if number) or "0"
    if not delays:
        return [frames, "", "", "", "", "", wrong]
    within, number, share = sum(delay <= WITHIN for delay in delays), len(at), float(np.median(at)) if at else 0.0
    slowest = np.sort(delays)[int(0.95 * len(delays))]
    delay = f"{np.median(delays):.0f}, {f'{slowest:.0f}' if np.isfinite(slowest) else 'not found'}"
    error = f"{share * scenario.slip_deg:.2g} deg, {100 * share * scenario.slip_m:.2g} cm"
    return [frames, f"{within} of {len(delays)}", f"{number} of {len(delays)}", delay, error, str(right), wrong]


def noise_of(fleet: Sequence[SimulatedVehicle]) -> PairNoise:
    """Return the noise that a report would estimate from this fleet of one type."""
    deviations = []
    for vehicle in fleet[:_SAMPLED_VEHICLES]:
        own = vehicle.checks.take(np.flatnonzero(vehicle.checks.usable))
        deviations.append(local_deviations(own.error, own.covariance))
    return PairNoise(noise_scale(deviations))


def logs_of(vehicle: SimulatedVehicle, noise: PairNoise) -> Float:
    """Return the log e-process (T, 6) of a vehicle after each check; checks without an estimate do not change it."""
    usable = vehicle.checks.usable
    own = vehicle.checks.take(np.flatnonzero(usable))
    logs = np.concatenate([np.zeros((1, len(AXES))), e_process(own.error, noise.covariance_of(own), TOLERANCE)])
    return logs[np.cumsum(usable)]


def _types(fleets: int, bank: NoiseBank, vehicles: int = 30, checks: int = 12) -> str:
    """Return how often a common yaw error of a type is found, and how often one is reported without an error."""
    tolerance, lines = np.repeat([0.03, 0.01], 3), []
    for rig in RIGS:
        # Measured noise of a rig has a median of zero; its mean is the bias of the simulation, not of a type.
        bias = bank.centred[bank.groups[rig]].mean(axis=0)
        for size in (0.0, 0.1, 0.15):
            detected = false = 0
            for number in range(fleets):
                scenario = Scenario(vehicles, checks, 10.0, (rig,), wrong_cad_deg=size, seed=1000 + number)
                own = [vehicle.checks for vehicle in simulated_fleet(scenario, bank)]
                means = np.stack([each.error.mean(axis=0) for each in own]) - bias
                sigmas = np.stack([np.sqrt(np.einsum("tii->ti", c.covariance).mean(axis=0) / len(c)) for c in own])
                alarms = discoveries(systematic(means, sigmas, tolerance).log_e, RATE)
                detected += bool(alarms[2]) and size > 0
                false += bool(np.delete(alarms, 2).any()) or (bool(alarms[2]) and size == 0)
            lines.append((f"`{rig}`", f"{size:g} deg", vehicles, fleets, detected, false))
    return table(("noise", "yaw of the type wrong by", "vehicles", "fleets", "found", "false: fleets"), lines)
