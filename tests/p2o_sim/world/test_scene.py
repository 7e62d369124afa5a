"""Solids are closed and look outwards; rays find them; a street has no holes."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError, se3
from p2o.geometry.motion import pose_at
from p2o_sim.world.mesh import Mesh, boxes, circle, cylinder, join, loft, tubes, wheel
from p2o_sim.world.scene import Material, Mover, Part, Scene

from tests.p2o_sim.walls import box, volume

GREY = Material("grey", (0.5, 0.5, 0.5))


def _is_closed(mesh: Mesh) -> bool:
    """Whether every edge of a face belongs to one other face, in the other direction."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    return {tuple(e) for e in edges.tolist()} == {(b, a) for a, b in edges.tolist()}


# A prism of n sides has the area n/2 sin(2 pi/n) r^2 of its polygon.
POLYGON = 8 * np.sin(2 * np.pi / 16)


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (box(2.0, 3.0, -1.0, 4.0), 30.0),
        (cylinder(0.5, 1.0, 3.0), POLYGON * 0.25 * 2),
        (cylinder(1.0, 0.0, 3.0, top_radius=0.5), POLYGON * 3 * (1 + 0.5 + 0.25) / 3),
        (wheel(1.0, 0.2, sides=16), POLYGON * 0.2),
        (loft([circle(1.0, 0.0), circle(2.0, 1.0), circle(1.0, 2.0)]), POLYGON * 2 * (1 + 2 + 4) / 3),
        (box(1.0, 1.0, 0.0, 1.0).moved(5.0, -3.0, 2.0, yaw_deg=33.0), 1.0),
        (join([box(1.0, 1.0, 0.0, 1.0), box(1.0, 1.0, 2.0, 3.0)]), 2.0),
        (boxes([[0, 0, 0], [5, 5, 5]], [[1, 2, 3], [6, 6, 6]]), 7.0),
        (tubes([[0, 0, 0], [1, 1, 1]], [[0, 0, 2], [4, 5, 1]], 0.5, sides=16), POLYGON * 0.25 * 7),
        (tubes([[0, 0, 0]], [[3, 0, 0]], [[1.0, 0.5]], sides=16), POLYGON * 3 * (1 + 0.5 + 0.25) / 3),
    ],
)
def test_solids_are_closed_and_have_the_volume_of_their_formula(mesh: Mesh, expected: float) -> None:
    assert _is_closed(mesh)
    assert volume([mesh]) == pytest.approx(expected, rel=1e-12)


def test_a_bend_keeps_lengths_along_the_middle_and_heights() -> None:
    line = Mesh(np.column_stack([np.linspace(0, 50, 501), np.zeros(501), np.full(501, 3.0)]), np.array([[0, 1, 2]]))
    bent = line.bent(0.01).vertices
    assert np.linalg.norm(np.diff(bent, axis=0), axis=1).sum() == pytest.approx(50, rel=1e-5)
    np.testing.assert_allclose(bent[-1], [100 * np.sin(0.5), 100 * (1 - np.cos(0.5)), 3.0], atol=1e-12)
    assert line.bent(0.0) is line


def test_rays_tell_distance_part_and_normal_or_nothing() -> None:
    scene = Scene((Part(box(1.0, 1.0, -1.0, 1.0).moved(4.5), GREY), Part(box(1.0, 9.0, -1.0, 1.0).moved(8.5), GREY)))
    directions = np.array([[1.0, 0, 0], [0.8, 0.6 / 2, 0], [-1.0, 0, 0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = scene.cast(np.zeros(3), directions)
    np.testing.assert_allclose(hits.distance_m, [4.0, 8.0 / directions[1, 0], np.inf], rtol=1e-12)
    assert scene.part_of_face[hits.face[:2]].tolist() == [0, 1]
    assert hits.face[2] == -1
    np.testing.assert_allclose(hits.normal, [[-1, 0, 0], [-1, 0, 0], [0, 0, 0]], atol=1e-12)


def test_rays_meet_a_mover_where_it_is_at_their_own_time() -> None:
    rng = np.random.default_rng(7)
    body = box(4.0, 2.0, -0.5, 1.0).moved(12.0, 3.0, 0.5)
    twist = np.array([0.4, -0.3, 2.0, -15.0, 6.0, 1.0])
    ground = Part(box(400.0, 400.0, -90.0, -3.0), GREY)
    scene = Scene((ground,), movers=(Mover((Part(body, GREY, 1),), twist),))
    times = np.repeat(rng.uniform(-0.2, 0.2, 6), 4000)
    origins = rng.uniform(-1.0, 1.0, (len(times), 3))
    directions = np.array([12.0, 3.0, 0.0]) + rng.uniform(-14, 14, (len(times), 3)) - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    together = scene.cast(origins, directions, times)
    met = 0
    for time_s in np.unique(times):
        rows = times == time_s
        there = Mesh(se3.apply(pose_at(twist, time_s), body.vertices), body.faces)
        still = Scene((ground, Part(there, GREY, 1))).cast(origins[rows], directions[rows])
        alone = scene.cast(origins[rows], directions[rows], float(time_s))
        for hits in (together.take(np.flatnonzero(rows)), alone):
            # Rays that graze an outline may fall to either side of it in single precision.
            same = hits.face == still.face
            assert same.mean() > 0.999
            np.testing.assert_allclose(hits.distance_m[same], still.distance_m[same], rtol=1e-6)
            np.testing.assert_allclose(hits.normal[same], still.normal[same], atol=1e-9)
        np.testing.assert_array_equal(alone.body > 0, alone.face >= len(ground.mesh.faces))
        to_sun = np.array([0.6, 0.0, 0.8])
        dark = Scene((ground, Part(there, GREY, 1))).blocked(origins[rows] - [0, 0, 2], to_sun)
        assert (scene.blocked(origins[rows] - [0, 0, 2], to_sun, float(time_s)) == dark).mean() > 0.999
        met += int((still.face >= len(ground.mesh.faces)).sum())
    assert met > 200


def test_an_empty_scene_is_refused() -> None:
    with pytest.raises(InputError, match="the scene is empty"):
        Scene(())
