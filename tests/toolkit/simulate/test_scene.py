"""Solids are closed and look outwards; rays find them; a street has no holes."""

from __future__ import annotations

import numpy as np
import pytest
from p2o import InputError
from p2o.simulate import Material, Mesh, Part, Scene, street
from p2o.simulate.mesh import blob, box, circle, cylinder, join, loft, wheel

GREY = Material("grey", (0.5, 0.5, 0.5))


def _volume(mesh: Mesh) -> float:
    """The volume by the divergence theorem: positive only if faces look outwards."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6)


def _is_closed(mesh: Mesh) -> bool:
    """Whether every edge of a face belongs to one other face, in the other direction."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    return {tuple(e) for e in edges.tolist()} == {(b, a) for a, b in edges.tolist()}


# A prism of n sides has the area n/2 sin(2 pi/n) r^2 of its polygon.
POLYGON = 8 * np.sin(2 * np.pi / 16)


@pytest.mark.parametrize(
    ("mesh", "volume"),
    [
        (box(2.0, 3.0, -1.0, 4.0), 30.0),
        (cylinder(0.5, 1.0, 3.0), POLYGON * 0.25 * 2),
        (cylinder(1.0, 0.0, 3.0, top_radius=0.5), POLYGON * 3 * (1 + 0.5 + 0.25) / 3),
        (wheel(1.0, 0.2, sides=16), POLYGON * 0.2),
        (loft([circle(1.0, 0.0), circle(2.0, 1.0), circle(1.0, 2.0)]), POLYGON * 2 * (1 + 2 + 4) / 3),
        (box(1.0, 1.0, 0.0, 1.0).moved(5.0, -3.0, 2.0, yaw_deg=33.0), 1.0),
        (join([box(1.0, 1.0, 0.0, 1.0), box(1.0, 1.0, 2.0, 3.0)]), 2.0),
    ],
)
def test_solids_are_closed_and_have_the_volume_of_their_formula(mesh: Mesh, volume: float) -> None:
    assert _is_closed(mesh)
    assert _volume(mesh) == pytest.approx(volume, rel=1e-12)


def test_a_smooth_blob_is_nearly_a_ball() -> None:
    ball = blob(2.0, np.random.default_rng(0), roughness=0.0)
    assert _is_closed(ball)
    assert _volume(ball) == pytest.approx(4 / 3 * np.pi * 8, rel=0.02)


def test_yaw_turns_counter_clockwise_seen_from_above() -> None:
    turned = box(2.0, 0.2, 0.0, 1.0).moved(yaw_deg=90.0)
    assert turned.vertices[:, 1].max() == pytest.approx(1.0)
    assert turned.vertices[:, 0].max() == pytest.approx(0.1)
    nose = Mesh(np.array([[1.0, 0, 0], [0, 0, 0], [0, 0, 1]]), np.array([[0, 1, 2]])).moved(yaw_deg=90.0)
    np.testing.assert_allclose(nose.vertices[0], [0, 1, 0], atol=1e-12)


def test_rays_tell_distance_and_part_or_nothing() -> None:
    scene = Scene((Part(box(1.0, 1.0, -1.0, 1.0).moved(4.5), GREY), Part(box(1.0, 9.0, -1.0, 1.0).moved(8.5), GREY)))
    directions = np.array([[1.0, 0, 0], [0.8, 0.6 / 2, 0], [-1.0, 0, 0]])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    hits = scene.cast(np.zeros(3), directions)
    np.testing.assert_allclose(hits.distance_m, [4.0, 8.0 / directions[1, 0], np.inf], rtol=1e-12)
    assert scene.part_of_face[hits.face[:2]].tolist() == [0, 1]
    assert hits.face[2] == -1


def test_an_empty_scene_is_refused() -> None:
    with pytest.raises(InputError, match="the scene is empty"):
        Scene(())


def test_the_same_seed_gives_the_same_street_and_another_seed_another() -> None:
    first, again, other = (street(np.random.default_rng(seed)) for seed in (5, 5, 6))
    assert first.mesh.vertices.tobytes() == again.mesh.vertices.tobytes()
    assert first.parts[-1].material == again.parts[-1].material
    assert first.mesh.vertices.tobytes() != other.mesh.vertices.tobytes()


@pytest.mark.parametrize("seed", range(3))
def test_a_street_has_ground_everywhere_and_room_for_the_rig(seed: int) -> None:
    scene = street(np.random.default_rng(seed))
    rng = np.random.default_rng(1)
    from_above = np.column_stack([rng.uniform([-30, -30], [110, 30], (20_000, 2)), np.full(20_000, 60.0)])
    down = scene.cast(from_above, np.tile([0.0, 0.0, -1.0], (20_000, 1)))
    assert (down.face >= 0).all()
    assert (from_above[:, 2] - down.distance_m).min() >= 0.0
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    around = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(720)])
    for height in (0.3, 1.0, 1.65, 2.5):
        assert scene.cast(np.array([0.0, 0.0, height]), around).distance_m.min() > 1.2
