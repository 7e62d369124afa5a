"""Files of a report: what other programs read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from p2o_fleet.fleet_state import FleetState, fleet_state
from p2o_fleet.outputs import summary_lines, write_state
from p2o_fleet.store import Store

from tests.p2o_fleet.fleet_data import filled, noise


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("fleet"))
    slipped = noise(1, 20)
    slipped[10:, 2] += 0.6
    filled(store, 'van "1"', slipped)
    filled(store, "van-2", noise(2, 20))
    return store


@pytest.fixture(scope="module")
def state(store: Store) -> FleetState:
    return fleet_state(store)


def test_json_has_the_alarm_with_axis_interval_onset_and_proposal(state: FleetState, tmp_path: Path) -> None:
    write_state(state, tmp_path)
    plain = json.loads((tmp_path / "fleet.json").read_text())
    assert plain["statuses"] == {"holds": 1, "slipped": 1, "wrong": 0, "cannot-tell": 0}
    [alarm] = plain["alarms"]
    assert (alarm["vehicle"], alarm["camera"], alarm["lidar"]) == ('van "1"', "front", "top")
    [axis] = alarm["axes"]
    assert axis["axis"] == "yaw"
    assert axis["low"] < 0.6 < axis["high"]
    assert alarm["since_interval"][0] <= "2026-01-02T00:00:00Z" <= alarm["since_interval"][1]
    assert len(plain["extrinsics"]) == 2
    [alarmed] = state.alarms
    assert alarmed.alarm is not None
    assert (np.array(alarm["proposal"]) == alarmed.alarm.proposal).all()


def test_the_summary_names_vehicle_axis_and_time(state: FleetState) -> None:
    head, alarm = summary_lines(state)
    assert head.startswith("2 extrinsics in use, 40 checks until 2026-01-02T21:36:00Z: 1 holds, 1 slipped")
    assert 'van "1", front and top: slipped: yaw +0.' in alarm
