"""The state of a fleet: what is an alarm, since when, by how much, and what it proposes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o import se3
from p2o.errors import InputError
from p2o.geometry.pose_error import pose_error
from p2o_fleet.evidence import Verdict
from p2o_fleet.fleet_state import ExtrinsicState, FleetRules, FleetStatus, fleet_state
from p2o_fleet.store import Store

from tests.p2o_fleet.fleet_data import BEGIN, POSE, SIGMA, drive, evidence, filled, noise


def states(store: Store, rules: FleetRules | None = None) -> dict[str, ExtrinsicState]:
    return {one.vehicle: one for one in fleet_state(store, rules).current}


def test_a_slip_is_reported_with_axis_onset_size_and_proposal_and_other_vehicles_hold(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for number in range(4):
        error = noise(number, 40)
        if number == 2:
            error[25:, 2] += 0.5
        filled(store, f"van-{number}", error)
    found = states(store)
    assert {name: one.status for name, one in found.items() if name != "van-2"} == {
        f"van-{number}": FleetStatus.HOLDS for number in (0, 1, 3)
    }
    slipped = found["van-2"]
    assert slipped.status is FleetStatus.SLIPPED
    assert slipped.alarm is not None
    [axis] = slipped.alarm.axes
    assert axis.axis == "yaw"
    assert axis.low < 0.5 < axis.high
    assert slipped.alarm.since_first <= BEGIN + 8640 * 25 <= slipped.alarm.since_last
    assert slipped.alarm.since == BEGIN + 8640 * 25
    # The extrinsic in use minus its error is the proposal.
    error_of_use = pose_error(POSE, slipped.alarm.proposal).per_axis
    assert error_of_use["yaw_deg"] == pytest.approx(axis.size, abs=1e-6)
    assert se3.distance_m(se3.inverse(slipped.alarm.proposal) @ POSE) < 1e-6 + abs(error_of_use["x_m"]) + 0.01
    assert slipped.alarm.proof[-1] == "folder:van-2/39"
    assert slipped.mean is not None
    assert slipped.mean.error[2] == pytest.approx(0.5, abs=0.06), "the present error is that after the slip"


def test_an_error_from_the_first_check_on_is_no_slip_and_one_within_the_tolerance_no_alarm(tmp_path: Path) -> None:
    store = Store(tmp_path)
    filled(store, "a", noise(0, 30) + [0, 0, 0, 0.12, 0, 0])
    filled(store, "b", noise(1, 60) + [0.15, 0.15, 0.15, 0.02, 0.02, 0.02])
    found = states(store)
    assert found["a"].status is FleetStatus.WRONG
    assert "wrong since the first check: x +1" in found["a"].reason
    assert found["b"].status is FleetStatus.HOLDS


def test_few_or_weak_checks_cannot_tell(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.add(evidence(drive("weak", 0), np.zeros(6), covariance=np.diag((20 * SIGMA) ** 2)).row() for _ in range(1))
    lost = {"verdict": Verdict.CANNOT_TELL, "reason": "too few pairs"}
    filled(store, "dirty", noise(0, 8))
    store.add(evidence(drive("dirty", number), **lost).row() for number in range(8, 14))
    found = states(store)
    assert found["weak"].status is FleetStatus.CANNOT_TELL
    assert "may stay undetected on roll" in found["weak"].reason
    assert found["dirty"].status is FleetStatus.CANNOT_TELL
    assert "no estimate in the last 5 checks: too few pairs" in found["dirty"].reason


def test_a_new_extrinsic_begins_a_new_history_and_ends_the_alarm(tmp_path: Path) -> None:
    store = Store(tmp_path)
    filled(store, "a", noise(0, 20) + [0, 0, 1.0, 0, 0, 0])
    store.add(
        evidence(drive("a", n), e, extrinsic_digest="new").row()
        for n, e in zip(range(20, 40), noise(1, 20), strict=True)
    )
    state = fleet_state(store)
    assert [(one.current, one.status) for one in state.extrinsics] == [
        (False, FleetStatus.WRONG),
        (True, FleetStatus.HOLDS),
    ]
    assert not state.alarms


def test_a_service_begins_a_new_history_with_its_own_error(tmp_path: Path) -> None:
    store = Store(tmp_path)
    filled(store, "a", noise(0, 20), service="")
    after = noise(1, 20) + [0.12, 0, 0, 0, 0, 0]
    store.add(evidence(drive("a", n, service="windscreen"), e).row() for n, e in zip(range(20, 40), after, strict=True))
    before, changed = fleet_state(store).extrinsics
    assert (before.service, changed.service, changed.first) == ("", "windscreen", BEGIN + 8640 * 20)
    assert before.mean is not None
    assert changed.mean is not None
    assert changed.mean.error[0] - before.mean.error[0] == pytest.approx(0.12, abs=0.05)


def test_a_wrong_nominal_extrinsic_shows_on_the_type_and_marks_the_alarms_of_its_vehicles(tmp_path: Path) -> None:
    store = Store(tmp_path)
    for number in range(12):
        filled(store, f"van-{number}", noise(number, 12) + [0, 0, 0, 0.08, 0, 0])
    filled(store, "car-0", noise(50, 12), vehicle_type="car")
    state = fleet_state(store)
    by_type = {one.vehicle_type: one for one in state.types}
    assert [error.axis for error in by_type["van"].alarms] == ["x"]
    assert by_type["van"].alarms[0].low < 0.08 < by_type["van"].alarms[0].high
    assert not by_type["car"].alarms
    assert len(state.alarms) == 12
    assert [one.reason for one in state.alarms if one.alarm is not None and not one.alarm.systematic] == []


def test_a_drift_with_temperature_is_no_slip(tmp_path: Path) -> None:
    store, without = Store(tmp_path / "known"), Store(tmp_path / "unknown")
    for number in range(8):
        # The temperature rises during the second half of the checks, as in spring.
        temperature = np.concatenate([np.zeros(30), np.full(30, 25.0)]) + number
        sizes = noise(number, 60) + np.outer(0.01 * temperature, np.eye(6)[1])
        known = [drive(f"van-{number}", at, temperature_c=float(degrees)) for at, degrees in enumerate(temperature)]
        store.add(evidence(one, size).row() for one, size in zip(known, sizes, strict=True))
        unknown = (replace(one, temperature_c=None) for one in known)
        without.add(evidence(one, size).row() for one, size in zip(unknown, sizes, strict=True))
    assert fleet_state(without).alarms
    state = fleet_state(store)
    assert not state.alarms
    [own] = state.types
    [text] = own.trends
    assert text.startswith("pitch ")
    assert float(text.split()[1]) == pytest.approx(0.01, abs=0.002)
    assert text.endswith("deg per degree Celsius")


@pytest.mark.parametrize(
    ("name", "value"), [("rate", 0.0), ("rate", 1.5), ("tolerance", "0deg 1cm"), ("notice", "far")]
)
def test_rules_out_of_bounds_are_refused(name: str, value: object) -> None:
    with pytest.raises(InputError):
        FleetRules(**{name: value})  # type: ignore[arg-type]


def _alarmed(store: Store) -> None:
    """Store 40 checks of a vehicle whose extrinsic slipped by half a degree, and those of one that holds."""
    error = noise(0, 40)
    error[20:, 2] += 0.5
    filled(store, "a", error)
    filled(store, "b", noise(1, 40))


@pytest.mark.parametrize(
    "stray",
    [
        {"time": 4070908800.0, "extrinsic_digest": "new"},
        {"time": 4070908800.0, "service": "windscreen"},
        {"service": "windscren"},
        {"extrinsic_digest": "new"},
        {"vehicle_type": "vna"},
        {"camera": "frnt"},
        {"time": 0.0, "extrinsic_digest": "new"},
        {"time": BEGIN + 30 * 8640 + 1, "service": "windscren"},
    ],
)
def test_a_stray_row_ends_no_alarm(tmp_path: Path, stray: dict[str, object]) -> None:
    store = Store(tmp_path)
    _alarmed(store)
    before = fleet_state(store, now=BEGIN + 1e8)
    store.add([{**evidence(drive("a", 40)).row(), **stray}])
    [alarmed] = fleet_state(store, now=BEGIN + 1e8).alarms
    assert (alarmed.vehicle, alarmed.status) == ("a", FleetStatus.SLIPPED)
    assert fleet_state(store, now=BEGIN + 1e8).until <= before.until + 8640


@pytest.mark.parametrize(
    ("change", "error"),
    [({"time": 4070908800.0, "extrinsic_digest": "new"}, 0.0), ({"service": "windscren"}, 0.5)],
    ids=["wrong clock", "new name"],
)
@pytest.mark.parametrize("count", [2, 10])
def test_a_wrong_clock_ends_no_alarm_nor_does_a_new_name_while_its_error_persists(
    tmp_path: Path, change: dict[str, object], error: float, count: int
) -> None:
    store = Store(tmp_path)
    _alarmed(store)
    rows = [evidence(drive("a", 40 + n), e + [0, 0, error, 0, 0, 0]).row() for n, e in enumerate(noise(2, count))]
    store.add({**row, **change, "time": change.get("time", row["time"]) + 60 * n} for n, row in enumerate(rows))  # type: ignore[operator]
    state = fleet_state(store, now=BEGIN + 1e8)
    assert [one.vehicle for one in state.alarms] == ["a"]
    assert (f"a: {count} checks have times in the future" in state.remarks) == ("time" in change)


def test_a_service_that_removes_the_error_ends_the_alarm_after_the_second_check(tmp_path: Path) -> None:
    store = Store(tmp_path)
    _alarmed(store)
    for count, alarms in ((1, 1), (2, 0)):
        store.add([evidence(drive("a", 39 + count, service="windscreen"), np.zeros(6)).row()])
        assert len(fleet_state(store).alarms) == alarms


def test_a_store_without_anything_that_can_be_read_is_refused(tmp_path: Path) -> None:
    store = Store(tmp_path)
    filled(store, "a", np.zeros((1, 6)))
    store.parts("a")[0].write_bytes(b"nothing")
    with pytest.raises(InputError, match="no evidence of the store can be read"):
        fleet_state(store)
