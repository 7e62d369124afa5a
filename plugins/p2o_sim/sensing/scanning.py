"""Simulate the measurements of a LiDAR in a scene."""

from __future__ import annotations

import numpy as np
from p2o import Bool, Cloud, Float, InputError, Int, se3
from p2o.reading import moved

from p2o_sim.sensing.lidar import CLEAR_AIR, Air, Beams, Lidar, Rosette
from p2o_sim.sensing.threads import in_slices
from p2o_sim.world.mesh import stacked
from p2o_sim.world.scene import Hits, Scene

# The footprint as five rays: the centre, and four at three quarters of its radius, with weights of a Gaussian beam.
_AROUND = np.array([[0.75, 0.0], [0.0, 0.75], [-0.75, 0.0], [0.0, -0.75]])
_WEIGHTS = np.array([0.4, 0.15, 0.15, 0.15, 0.15])
# A mirror reflects the pulse back only at normal incidence.
_MIRROR_POWER = 40
# Standard deviation of the logarithm of the energy of returns (speckle, roughness).
_SPECKLE = 0.25
_SAME_PLANE_M = 1e-3
_RAYS_A_SLICE = 32_768


def sweep(
    scene: Scene,
    lidar: Lidar | Rosette,
    world_from_lidar: Float,
    rng: np.random.Generator,
    *,
    twist: Float | None = None,
    time_s: float = 0.0,
    air: Air = CLEAR_AIR,
) -> Cloud:
    """Simulate one sweep of a LiDAR at world_from_lidar (4, 4), centred on the scene's `time_s`.

    The sensor moves at constant `twist` (6,), rad/s and m/s in its own frame, and is at world_from_lidar in the middle
    of the sweep; points are in its frame at the time of their own pulse, as for real sensors. Pulses without a return
    have no point. The cloud has `column`, `time_s` relative to the middle, `intensity` (reflectance with incidence, in
    steps of 0.01) and, except for a rosette, `ring`. The `air` attenuates returns and adds those of drops.

    Raises InputError without a return.
    """
    beams = lidar.beams
    count = len(beams.directions)
    scene.prepare()
    # Drawn for every pulse, so that the noise of one point does not depend on the returns of others.
    range_noise, wobble = rng.standard_normal(count), rng.standard_normal((count, 2))
    speckle = np.exp(_SPECKLE * rng.standard_normal(count) - _SPECKLE**2 / 2)
    aimed = _tilted(beams.directions, np.radians(lidar.angle_noise_deg) * wobble)

    pulses = _Pulses(scene, world_from_lidar, np.zeros(6) if twist is None else twist, beams, time_s)
    middle = pulses.cast(aimed, np.arange(count))
    strength = _strength(scene, middle, pulses.world(aimed, np.arange(count)))
    distance = middle.distance_m.copy()
    if lidar.divergence_mrad > 0:
        rows = np.flatnonzero(_may_be_split(scene, middle, beams))
        distance[rows], strength[rows] = _merged(pulses, lidar, aimed, rows, middle, strength[rows])

    energy = strength * speckle / np.maximum(distance, 0.1) ** 2
    if air.extinction_per_m > 0:
        energy *= np.exp(-2 * air.extinction_per_m * np.where(np.isfinite(distance), distance, 0.0))
    if air.drops > 0:
        _add_drops(air, lidar, rng, distance, strength, energy)
    seen = (distance >= lidar.min_range_m) & (distance <= lidar.max_range_m)
    rows = np.flatnonzero(seen & (energy > 0.1 / lidar.dark_range_m**2))
    if not len(rows):
        raise InputError("the LiDAR has no returns", where=lidar.name, hint="is it inside a solid, or too far away?")
    measured = distance[rows] + lidar.range_noise_m * range_noise[rows]
    return Cloud(
        beams.origins[rows] + measured[:, None] * beams.directions[rows],
        ring=None if beams.ring is None else beams.ring[rows],
        column=beams.column[rows],
        time_s=beams.time_s[rows],
        intensity=np.asarray(np.round(np.clip(strength[rows], 0.0, 0.99), 2), np.float64),
    )


def _add_drops(
    air: Air, lidar: Lidar | Rosette, rng: np.random.Generator, distance: Float, strength: Float, energy: Float
) -> None:
    """Replace, in place, the returns (N,) of pulses by weak and near ones if they hit a drop first."""
    count = len(distance)
    met, share = rng.random(count) < air.drops, rng.uniform(0.005, 0.06, count)
    where = lidar.min_range_m + rng.exponential(air.drops_m, count)
    rows = np.flatnonzero(met & (where < distance) & (share / where**2 > 0.1 / lidar.dark_range_m**2))
    distance[rows], strength[rows], energy[rows] = where[rows], share[rows], share[rows] / where[rows] ** 2


class _Pulses:
    """Rays of pulses in the world, from a sensor that moves during the sweep."""

    def __init__(self, scene: Scene, world_from_lidar: Float, twist: Float, beams: Beams, time_s: float) -> None:
        self.scene, self.pose, self.twist, self.beams, self.start_s = scene, world_from_lidar, twist, beams, time_s
        self.moves = bool(np.any(twist))

    def world(self, directions: Float, rows: Int) -> Float:
        """Return directions (M, 3) of pulses `rows` in the world frame."""
        if self.moves:
            directions = moved(self.twist, self.beams.time_s[rows], directions, directions=True)
        return directions @ self.pose[:3, :3].T

    def cast(self, directions: Float, rows: Int) -> Hits:
        """Return the first hits of pulses `rows` along directions (M, 3) of the LiDAR frame."""
        count = len(rows)
        out = Hits(np.empty(count), np.empty(count, np.int64), np.empty((count, 3)), np.empty(count, np.int64))
        still = not self.scene.movers

        def look(part: slice) -> None:
            chosen = rows[part]
            origins = self.beams.origins[chosen]
            if self.moves:
                origins = moved(self.twist, self.beams.time_s[chosen], origins)
            when = self.start_s if still else self.start_s + self.beams.time_s[chosen]
            hits = self.scene.cast(se3.apply(self.pose, origins), self.world(directions[part], chosen), when)
            for name in ("distance_m", "face", "normal", "body"):
                getattr(out, name)[part] = getattr(hits, name)

        in_slices(look, count, _RAYS_A_SLICE)
        return out


def _strength(scene: Scene, hits: Hits, world_directions: Float) -> Float:
    """Return the reflected share (N,) of a pulse at 1 m: reflectance with incidence, minus specular reflection."""
    reflectance, gloss = scene.material_table(("reflectance", "gloss"))
    part = scene.part_of_face[hits.face]
    facing = np.abs(np.einsum("ni,ni->n", hits.normal, world_directions))
    scattered = (1 - gloss[part]) * facing
    out = reflectance[part] * scattered
    shiny = np.flatnonzero(gloss[part] > 0)
    out[shiny] += reflectance[part[shiny]] * gloss[part[shiny]] * facing[shiny] ** _MIRROR_POWER
    out[hits.face < 0] = 0.0
    return np.asarray(out)


def _may_be_split(scene: Scene, hits: Hits, beams: Beams) -> Bool:
    """Return the mask (N,) of pulses with a neighbour in the grid on another part or plane; all without a grid."""
    if beams.grid is None:
        return np.ones(len(hits.face), bool)
    part = np.where(hits.face < 0, -1, scene.part_of_face[hits.face]).reshape(beams.grid)
    normal = hits.normal.astype(np.float32).reshape(*beams.grid, 3)
    split = np.zeros(beams.grid, bool)
    turning = np.roll(part, -1, axis=1) != part
    turning |= np.einsum("rci,rci->rc", np.roll(normal, -1, axis=1), normal) < 0.999
    split |= turning | np.roll(turning, 1, axis=1)
    below = (part[:-1] != part[1:]) | (np.einsum("rci,rci->rc", normal[:-1], normal[1:]) < 0.999)
    split[:-1] |= below
    split[1:] |= below
    return np.asarray((split & (part.max() >= 0)).ravel())


def _merged(
    pulses: _Pulses, lidar: Lidar | Rosette, aimed: Float, rows: Int, middle: Hits, middle_strength: Float
) -> tuple[Float, Float]:
    """Return distance (M,) and strength (M,) of pulses `rows` whose footprint may cover several surfaces."""
    distance = np.empty((len(rows), 1 + len(_AROUND)))
    strength = np.empty_like(distance)
    distance[:, 0], strength[:, 0] = middle.distance_m[rows], middle_strength
    one_plane = middle.face[rows] >= 0
    normal, radius = middle.normal[rows], lidar.divergence_mrad / 2000
    at = pulses.world(aimed[rows], rows) * np.where(one_plane, distance[:, 0], 0.0)[:, None]
    for column, offset in enumerate(_AROUND, start=1):
        directions = _tilted(aimed[rows], np.broadcast_to(radius * offset, (len(rows), 2)))
        hits = pulses.cast(directions, rows)
        world = pulses.world(directions, rows)
        distance[:, column], strength[:, column] = hits.distance_m, _strength(pulses.scene, hits, world)
        with np.errstate(invalid="ignore"):
            away = np.einsum("ni,ni->n", normal, world * hits.distance_m[:, None] - at)
            one_plane &= np.abs(away) < _SAME_PLANE_M

    # On one plane the central ray is exact; the mean would be too far by the square of the divergence.
    out, power = distance[:, 0].copy(), strength[:, 0].copy()
    split = np.flatnonzero(~one_plane)
    mean, total = _echo(distance[split], strength[split], lidar)
    out[split], power[split] = np.where(total > 0, mean, np.inf), total * mean**2
    return out, power


def _echo(distance: Float, strength: Float, lidar: Lidar | Rosette) -> tuple[Float, Float]:
    """Return distance and energy (N,) of the selected echo of sub-rays (N, K); echoes closer than a pulse merge."""
    far = np.where(np.isfinite(distance), distance, 1e6)
    energy = _WEIGHTS * strength / far**2
    together = np.abs(far[:, :, None] - far[:, None, :]) < lidar.pulse_m
    group = np.einsum("nij,nj->ni", together, energy)
    if lidar.keeps == "strongest":
        chosen = np.argmax(group, axis=1)
    else:
        enough = group > 0.1 / lidar.dark_range_m**2
        chosen = np.argmin(np.where(enough, far, np.inf), axis=1)
    members = np.take_along_axis(together, chosen[:, None, None], axis=1)[:, 0] * energy
    total = members.sum(axis=1)
    return (members * far).sum(axis=1) / np.where(total > 0, total, 1.0), total


def _tilted(directions: Float, angles: Float) -> Float:
    """Return unit directions (N, 3) rotated by small angles (N, 2) rad to the left and upwards."""
    if not np.any(angles):
        return directions
    left = stacked(-directions[:, 1], directions[:, 0], 0.0)
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12)
    up = np.cross(directions, left)
    turned = directions + angles[:, :1] * left + angles[:, 1:] * up
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))
