from __future__ import annotations

import numpy as np
import pytest
from p2o import Cloud, InputError, se3

XYZ = np.arange(12.0).reshape(4, 3) + 1


def test_points_are_kept_in_order_and_cannot_be_changed_and_selecting_takes_all_fields_alike() -> None:
    mine = XYZ.copy()
    Cloud(mine)
    assert mine.flags.writeable
    cloud = Cloud(XYZ.astype(np.float32), ring=[3, 2, 1, 0], intensity=np.ones(4, np.float32))
    assert np.array_equal(cloud.xyz, XYZ)
    assert (cloud.xyz.dtype, cloud.ring.dtype, cloud.intensity.dtype) == (np.float64, np.int64, np.float64)
    assert len(cloud) == 4
    with pytest.raises(ValueError, match="read-only"):
        cloud.xyz[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        cloud.ring[0] = 0
    cloud = Cloud(XYZ, ring=[0, 1, 2, 3], column=[9, 8, 7, 6])
    for index in (np.array([2, 0]), np.array([True, False, True, False])):
        part = cloud.select(index)
        assert np.array_equal(part.xyz, XYZ[index])
        assert np.array_equal(part.ring, np.arange(4)[index])
        assert np.array_equal(part.column, np.array([9, 8, 7, 6])[index])
        assert part.intensity is None


@pytest.mark.parametrize(
    ("xyz", "message"),
    [
        (np.zeros((0, 3)), "the cloud has no points"),
        (np.ones((4, 2)), r"xyz has the wrong shape; expected \(any, 3\); got \(4, 2\)"),
        (np.ones(3), "xyz has the wrong shape"),
        ("points", "xyz is not an array of numbers"),
        (np.array([[1, 2, np.nan]]), "xyz contains values that are not finite; .*1 NaN or infinite"),
        (np.array([[1, np.inf, 3]]), "xyz contains values that are not finite"),
    ],
)
def test_what_is_no_cloud_is_refused(xyz: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Cloud(xyz)


@pytest.mark.parametrize("field", ["ring", "intensity", "time_s", "column"])
def test_every_field_has_one_value_a_point_and_a_finite_one(field: str) -> None:
    with pytest.raises(InputError, match=rf"{field} has the wrong shape; expected \(4\); got \(3,\)"):
        Cloud(XYZ, **{field: np.zeros(3)})
    if field in ("intensity", "time_s"):
        with pytest.raises(InputError, match=rf"{field} contains values that are not finite"):
            Cloud(XYZ, **{field: np.array([0, 1, np.nan, 2])})


def test_missing_returns_are_dropped_from_every_field_and_counted() -> None:
    raw = np.array([[1.0, 2, 3], [np.nan, 0, 0], [0, 0, 0], [0, 0, 5], [np.inf, 1, 1]])
    cloud, warnings = Cloud.from_raw(raw, ring=np.arange(5), time_s=None)
    assert np.array_equal(cloud.xyz, [[1, 2, 3], [0, 0, 5]])
    assert np.array_equal(cloud.ring, [0, 3])
    assert cloud.time_s is None
    assert warnings == ("2 of 5 points dropped: NaN or infinite", "1 of 5 points dropped: all zero")
    assert Cloud.from_raw(XYZ)[1] == ()
    for value, kind in ((0.0, "3 all-zero"), (np.nan, "3 NaN or infinite")):
        with pytest.raises(InputError, match=f"the cloud has no valid point; .*{kind} points"):
            Cloud.from_raw(np.full((3, 3), value))
    with pytest.raises(InputError, match="the cloud has no points"):
        Cloud.from_raw(np.zeros((0, 3)))


def test_a_corrected_sweep_tells_what_was_measured() -> None:
    """Ten metres ahead of a sensor that drives 10 m/s: half a second before, the same point was 15 m away."""
    cloud = Cloud([[10.0, 0, 0], [10, 0, 0]], time_s=[-0.5, 0.0], twist=[0, 0, 0, 10, 0, 0])
    np.testing.assert_allclose(cloud.as_measured(), [[15, 0, 0], [10, 0, 0]])
    np.testing.assert_allclose(cloud.select(np.array([1, 0])).as_measured(), [[10, 0, 0], [15, 0, 0]])
    raw = Cloud([[10.0, 0, 0]], time_s=[0.1])
    assert raw.as_measured() is raw.xyz
    with pytest.raises(InputError, match="has no times"):
        Cloud([[1.0, 0, 0]], twist=[0, 0, 0, 1, 0, 0])
    with pytest.raises(InputError, match="twist"):
        Cloud([[1.0, 0, 0]], time_s=[0.0], twist=[1, 2, 3])


TWIST = np.array([0.05, -0.02, 0.3, 12.0, 0.4, -0.1])
TIMES = np.array([-0.03, 0.0, 0.02, 0.05])


def test_a_sweep_for_a_later_moment_is_seen_from_where_the_sensor_is_then() -> None:
    """As measured it stays as it is, only its times count from then; what was corrected is corrected to then."""
    raw = Cloud(XYZ, time_s=TIMES)
    later = raw.later(0.01, TWIST)
    assert np.array_equal(later.xyz, XYZ)
    assert np.allclose(later.time_s, TIMES - 0.01)
    corrected = raw.untwisted(TWIST).later(0.01, TWIST)
    assert np.allclose(corrected.xyz, later.untwisted(TWIST).xyz, atol=1e-12)
    assert np.allclose(corrected.as_measured(), XYZ, atol=1e-12)
    expected = se3.apply(se3.exp(-0.01 * TWIST), raw.untwisted(TWIST).xyz)
    assert np.allclose(corrected.xyz, expected, atol=1e-12)
    timeless = Cloud(XYZ).later(0.01, TWIST)  # is moved as a whole
    assert np.allclose(timeless.xyz, se3.apply(se3.exp(-0.01 * TWIST), XYZ), atol=1e-12)
    assert timeless.time_s is None
