"""Rings of sweeps in firing order: the lasers of two blocks alternate, and no point names its laser."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from p2o import Cloud, Dataset, Registry
from p2o.cli.data import ring_count
from p2o.host.method import Kind
from p2o.reading import RingsUnknownError
from p2o.run.recipe import open_dataset as opened
from p2o_plugins.cloud.firing_order import rings_in_firing_order
from p2o_plugins.cloud.sweep import order_sweep

ROOT = Path(__file__).parents[3]
FIRINGS = 2083


def fired(cloud: Cloud, *, dropped: float = 0.0, seed: int = 0) -> Cloud:
    """Return the points as an HDL-64 stores them: 32 lasers of the upper block, 32 of the lower one, and so on.

    The lasers of a block fire in an order that is not that of their elevations, at azimuths that differ by up to 16
    deg, clockwise. A share of the returns is dropped.
    """
    rng = np.random.default_rng(seed)
    x, y, _ = cloud.as_measured().T
    place = np.concatenate([rng.permutation(32), 32 + rng.permutation(32)])[cloud.ring]
    head = np.mod(-np.arctan2(y, x) + np.radians(rng.uniform(-8, 8, 64))[cloud.ring], 2 * np.pi)
    order = np.lexsort((place, np.floor(head / (2 * np.pi) * FIRINGS)))
    return cloud.select(order[rng.random(len(order)) >= dropped])


def open_dataset(text: str) -> Dataset:
    return opened(text, Registry.load(environ={}))


def without_rings(cloud: Cloud) -> Cloud:
    return replace(cloud, ring=None, column=None)


@pytest.fixture(scope="module")
def hall() -> Cloud:
    return open_dataset("synthetic:?place=hall&right=false&speed_m_s=0")[0].cloud


@pytest.mark.parametrize("dropped", [0.0, 0.3])
def test_rings_of_a_simulated_hdl_64_are_exact_whatever_is_dropped(hall: Cloud, dropped: float) -> None:
    cloud = fired(hall, dropped=dropped)
    np.testing.assert_array_equal(rings_in_firing_order(without_rings(cloud)), cloud.ring)


def test_a_sweep_in_firing_order_is_ordered_as_with_its_rings(hall: Cloud) -> None:
    cloud = fired(hall, seed=1)
    own, given = order_sweep(without_rings(cloud)), order_sweep(cloud)
    np.testing.assert_array_equal(own.ring, given.ring)
    np.testing.assert_array_equal(own.point, given.point)


def test_a_compensated_sweep_is_resolved_if_its_velocity_is_known_and_else_refused(hall: Cloud) -> None:
    cloud = fired(hall).untwisted(np.array([0.0, 0.0, 0.1, 10.0, 0.0, 0.0]))
    np.testing.assert_array_equal(rings_in_firing_order(without_rings(cloud)), cloud.ring)
    assert rings_in_firing_order(replace(without_rings(cloud), twist=None)) is None


def test_a_check_says_what_is_recovered_and_by_which_extractor(hall: Cloud) -> None:
    extractors = Registry.load(environ={}).of_kind(Kind.CLOUD_EXTRACTOR)
    cloud = without_rings(fired(hall, seed=1))
    assert ring_count(cloud, extractors) == "64 rings recovered by `rings` from the firing order of the points"
    assert ring_count(cloud) == "no rings", "without the extractor nothing recovers them"
    shuffled = cloud.select(np.random.default_rng(0).permutation(len(cloud))[::8])
    assert ring_count(shuffled, extractors) == "no rings"


@pytest.mark.parametrize(("lidar", "sweep_s"), [("mid-40", 0.1), ("avia", 0.2), ("mid-360", 0.1)])
def test_patterns_that_do_not_repeat_have_no_rings(lidar: str, sweep_s: float) -> None:
    rosette = open_dataset(f"synthetic:?place=hall&right=false&width_px=64&lidar={lidar}&sweep_s={sweep_s}")[0].cloud
    assert rings_in_firing_order(rosette) is None
    with pytest.raises(RingsUnknownError):
        order_sweep(rosette)


def test_few_points_and_points_on_the_axis_have_no_rings() -> None:
    for xyz in (np.ones((10, 3)), np.tile([0.0, 0.0, 1.0], (1000, 1))):
        assert rings_in_firing_order(Cloud(xyz)) is None


@pytest.mark.real
@pytest.mark.parametrize("dropped", [0.0, 0.3])
def test_rings_of_real_sweeps_in_firing_order_are_those_of_the_files(real_data: Path, dropped: float) -> None:
    """KITTI's files are ordered by ring; some ten returns on the seam of two rings have the number of the next."""
    dataset = open_dataset(f"kitti-raw:{real_data / 'kitti_raw'}?right=false")
    names = json.loads((ROOT / "baselines/p2o_baselines/suites/splits.json").read_text())["drive_0005_later"][::56]
    for seed, name in enumerate(names):
        cloud = fired(dataset[dataset.names.index(name)].cloud, dropped=dropped, seed=seed)
        ring = rings_in_firing_order(without_rings(cloud))
        assert ring is not None, name
        assert np.mean(ring != cloud.ring) < 1e-4, name
