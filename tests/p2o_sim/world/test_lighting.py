"""Lamps and the light inside of buildings: falls with distance, casts shadows, stays inside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from p2o import Camera
from p2o_sim.sensing.rendering import render
from p2o_sim.world.lighting import Inside, Lamp, Lighting
from p2o_sim.world.scene import Material, Part, Scene

from tests.p2o_sim.walls import box, down_axis

CAMERA = Camera.pinhole(50.0, 50.0, 50.0, 50.0, 101, 101)
"""From 10 m above it shows 20 x 20 m, 0.2 m a pixel."""
PLAIN = Material("plain", (0.5, 0.5, 0.5), contrast=0.0)
NIGHT = Lighting(sun=0.0, sky=(0.0, 0.0, 0.0), haze_m=1e9)


def _floor(lighting: Lighting, *more: Part) -> np.ndarray:
    """Return the light (101, 101) on a floor at z = 0 seen from 10 m above; row 50, column 50 is the origin."""
    scene = Scene((Part(box(40.0, 40.0, -1.0, 0.0), PLAIN), *more), lighting=lighting)
    return render(scene, CAMERA, down_axis(10.0)).light[..., 1]


def test_the_light_of_a_lamp_falls_with_the_square_of_its_distance_and_with_the_slant() -> None:
    lamp = Lamp((0.0, 0.0, 2.0), (1.0, 1.0, 1.0), size_m=0.0)
    light = _floor(replace(NIGHT, lamps=(lamp,)))
    assert light[50, 50] == pytest.approx(0.5 / 4, rel=3e-3)
    # 2 m beside its foot: distance squared 8, cosine 1 / sqrt(2).
    assert light[50, 60] == pytest.approx(0.5 / 8 / np.sqrt(2), rel=3e-3)


def test_a_lamp_with_an_aim_lights_what_it_looks_at() -> None:
    aside = Lamp((0.0, 0.0, 2.0), (1.0, 1.0, 1.0), size_m=0.0, aim=(1.0, 0.0, -1.0), sharpness=4.0)
    light = _floor(replace(NIGHT, lamps=(aside,)))
    assert light[50, 60] == pytest.approx(0.5 / 8 / np.sqrt(2), rel=3e-3)
    assert light[50, 40] == pytest.approx(0.0, abs=1e-6)


def test_what_is_between_a_lamp_and_the_floor_casts_a_shadow_and_what_is_behind_the_lamp_none() -> None:
    lamp = replace(NIGHT, lamps=(Lamp((0.0, 0.0, 2.0), (4.0, 4.0, 4.0)),))
    under = _floor(lamp, Part(box(0.4, 0.4, 0.9, 1.0).moved(1.0), PLAIN))
    # At half the height it hides a square twice its size and twice as far away.
    assert under[50, 60] == 0.0
    assert under[50, 40] > 0.05
    above = _floor(lamp, Part(box(0.4, 0.4, 3.0, 3.1).moved(2.0), PLAIN))
    assert above[50, 66] > 0.02


def test_the_light_of_a_room_is_inside_of_it_and_darker_in_its_corners() -> None:
    inside = Inside((-4.0, -4.0, -1.0), (4.0, 4.0, 3.0), (0.6, 0.6, 0.6), lean=(0.0, 0.0, 0.1))
    light = _floor(replace(NIGHT, inside=inside))
    assert light[50, 50] == pytest.approx(0.5 * 0.6 * 1.1, rel=0.02)
    assert light[50, 50 + 25] == 0.0
    assert light[50 - 19, 50 + 19] < 0.9 * light[50, 50]


def test_what_glows_is_bright_in_the_dark() -> None:
    pane = Part(box(2.0, 2.0, 0.0, 0.1), replace(PLAIN, glow=1.5))
    light = _floor(NIGHT, pane)
    assert light[50, 50] == pytest.approx(0.75)
    assert light[50, 80] == 0.0
