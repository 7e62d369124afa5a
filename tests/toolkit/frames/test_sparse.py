"""Fewer rings, or none, as options of every data set."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o import Cloud, Frame, InputError
from p2o.frames.rings import RingsUnknownError, rings_of
from p2o.frames.sparse import SparseOptions, sparse, with_sparse_options
from p2o.host.method import Kind
from p2o.host.registry import Registry
from p2o.run.recipe import open_dataset

from tests.toolkit.frames.test_rings import shuffled, sweep

STREET = "synthetic:?scenes=1&right=false"


@pytest.fixture(scope="module")
def street():
    return open_dataset(STREET, Registry.load())[0]


def changed(street: Frame, cloud: Cloud, **options) -> Cloud:
    return sparse(replace(street, cloud=cloud), SparseOptions(**options)).cloud


def elevation_deg(cloud: Cloud):
    return np.degrees(np.arctan2(cloud.xyz[:, 2], np.hypot(cloud.xyz[:, 0], cloud.xyz[:, 1])))


@pytest.mark.parametrize("names", [np.arange(16), np.arange(16)[::-1], np.random.default_rng(3).permutation(16) * 7])
def test_every_fourth_ring_is_kept_from_the_highest_whatever_the_rings_are_called(street, names):
    cloud = sweep()
    kept = changed(street, replace(cloud, ring=names[cloud.ring]), keep_rings=4)
    np.testing.assert_array_equal(np.unique(kept.ring), range(4))
    for ring, degrees in enumerate((15, 7, -1, -9)):
        np.testing.assert_allclose(elevation_deg(kept)[kept.ring == ring], degrees)


def test_rings_that_the_file_does_not_number_are_numbered_after_thinning_and_all_fields_kept_in_order(street):
    kept = changed(street, Cloud(sweep().xyz), keep_rings="1/2")
    np.testing.assert_allclose(elevation_deg(kept), 15 - 4 * kept.ring)
    assert len(kept) == 8 * 360
    both = changed(street, sweep(), keep_rings=4, forget_rings=True)
    assert (len(both), both.ring) == (4 * 360, None)
    assert sparse(street, SparseOptions()) is street
    cloud = sweep()
    numbered = np.arange(len(cloud))
    cloud = replace(cloud, intensity=numbered / 1e4, time_s=numbered / 1e5, column=numbered, twist=np.zeros(6))
    kept = changed(street, cloud, keep_rings=8)
    assert np.all(np.diff(kept.column) > 0)
    np.testing.assert_array_equal(kept.xyz, cloud.xyz[kept.column])
    np.testing.assert_array_equal(kept.intensity, kept.column / 1e4)
    np.testing.assert_array_equal(kept.time_s, kept.column / 1e5)
    assert kept.twist is not None


def test_forgotten_rings_cannot_be_recovered_from_the_order_of_the_points(street):
    cloud = sweep(lift_m=0.2)
    numbered = replace(cloud, intensity=np.arange(len(cloud)))
    forgotten = changed(street, numbered, forget_rings=True)
    assert forgotten.ring is None
    np.testing.assert_array_equal(forgotten.xyz, cloud.xyz[forgotten.intensity.astype(int)])
    np.testing.assert_array_equal(np.sort(forgotten.intensity), np.arange(len(cloud)))
    with pytest.raises(RingsUnknownError):
        rings_of(forgotten)
    again, other = (
        sparse(replace(street, cloud=numbered, name=name), SparseOptions(forget_rings=True)).cloud.intensity
        for name in (street.name, "another")
    )
    np.testing.assert_array_equal(again, forgotten.intensity)
    assert np.any(other != again)


def test_unknown_rings_cannot_be_thinned_nor_known_ones_to_a_single_one(street):
    with pytest.raises(InputError, match=r"cannot keep every 4\. ring") as caught:
        changed(street, shuffled(replace(sweep(lift_m=0.2), ring=None)), keep_rings=4)
    assert "\n" not in str(caught.value)
    assert street.name in str(caught.value)
    with pytest.raises(InputError, match=r"expected keep_rings < 16"):
        changed(street, sweep(), keep_rings=16)


@pytest.mark.parametrize("text", ["0", "-2", "1/0", "65", "2/3", "half", "1.5", ""])
def test_a_wrong_step_is_an_error_of_one_line(text):
    with pytest.raises(InputError, match=r"data\.keep_rings is (not valid|out of bounds); expected .+") as caught:
        open_dataset(f"{STREET}&keep_rings={text}", Registry.load())
    assert "\n" not in str(caught.value)


def test_every_data_set_has_the_options_unless_it_has_one_of_that_name():
    offers = Registry.load().of_kind(Kind.DATASET)
    assert len(offers) > 10
    assert [o.name for o in offers if not issubclass(o.method.options, SparseOptions)] == []
    assert all(list(o.method.options.model_fields)[-2:] == ["keep_rings", "forget_rings"] for o in offers)

    class Own(p2o.Options):
        keep_rings: str = "mine"

    assert with_sparse_options(Own) is Own


def test_command_line_python_and_settings_give_the_same_sweep():
    registry = Registry.load()
    text = open_dataset(f"{STREET}&lidar=vlp-16&keep_rings=1/4", registry)[0].cloud
    setting = open_dataset(f"{STREET}&lidar=vlp-16", registry, {"keep_rings": 4})[0].cloud
    np.testing.assert_array_equal(text.xyz, setting.xyz)
    np.testing.assert_array_equal(np.unique(text.ring), range(4))
