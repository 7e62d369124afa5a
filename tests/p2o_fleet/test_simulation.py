"""Simulated fleets: measured noise, known faults, and the store that they are written to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fleet_detection import logs_of, noise_of
from p2o.errors import InputError
from p2o_fleet.simulation import Fault, NoiseBank, Scenario, simulated_fleet, write_fleet
from p2o_fleet.statistics import discoveries
from p2o_fleet.store import Store

BANK = NoiseBank.shipped()
SCENARIO = Scenario(40, 60, rigs=("kitti",))


def test_the_shipped_noise_has_positive_definite_covariances_and_a_median_of_zero() -> None:
    assert len(BANK.groups["kitti"]) >= 40
    assert (np.linalg.eigvalsh(BANK.covariance) > 0).all()
    for rows in BANK.groups.values():
        assert np.median(BANK.centred[rows], axis=0) == pytest.approx(np.zeros(6), abs=1e-9)


def test_a_store_of_simulated_checks_is_read_as_they_were(tmp_path: Path) -> None:
    scenario = replace(SCENARIO, vehicles=2, checks=100, per_day=2.0, shares={Fault.BROKEN: 1.0})
    fleet = list(simulated_fleet(scenario, BANK))
    store = Store(tmp_path)
    assert write_fleet(simulated_fleet(scenario, BANK), store) == 200, "the same seed gives the same fleet"
    assert {path.parent.name for path in store.parts(fleet[0].name)} == {"day=2020-01", "day=2020-02"}
    for read, written in zip(store.checks(), fleet, strict=True):
        assert (read.usable == written.checks.usable).all()
        assert np.nan_to_num(read.error) == pytest.approx(np.nan_to_num(written.checks.error))
        assert np.nan_to_num(read.covariance) == pytest.approx(np.nan_to_num(written.checks.covariance))
        assert read.texts["verdict"].tolist() == written.checks.texts["verdict"].tolist()


def test_slips_of_half_a_degree_or_5_cm_are_found_within_200_frames_and_nothing_else() -> None:
    fleet = list(simulated_fleet(replace(SCENARIO, shares={Fault.SLIP: 0.25}), BANK))
    model = noise_of(fleet)
    logs = np.stack([np.logaddexp.reduce(logs_of(vehicle, model), axis=1) - np.log(6) for vehicle in fleet])
    alarms = np.stack([discoveries(column, 0.01) for column in logs.T], axis=1)
    slipped = [number for number, vehicle in enumerate(fleet) if vehicle.fault is Fault.SLIP]
    assert len(slipped) >= 5
    for number, vehicle in enumerate(fleet):
        began = vehicle.begin if number in slipped else len(vehicle.checks)
        assert not alarms[number, :began].any()
        if number in slipped:
            assert vehicle.checks.frame_count[began:][: alarms[number, began + 1 :].argmax() + 1].sum() <= 200
            assert alarms[number, began + 1 :].any()


def test_impossible_shares_are_refused() -> None:
    with pytest.raises(InputError, match="shares of at most 1"):
        replace(SCENARIO, shares={Fault.SLIP: 0.7, Fault.DRIFT: 0.7})
