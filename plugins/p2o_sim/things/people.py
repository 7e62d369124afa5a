"""Pedestrians and cyclists, facing +x."""

from __future__ import annotations

import numpy as np
from p2o import Float

from p2o_sim.world.mesh import Mesh, circle, join, loft, stacked, tubes
from p2o_sim.world.palette import CLOTH, DARK_STEEL, RUBBER, SKIN, pick
from p2o_sim.world.scene import Class, Material, Part, built

_Hands = Float | tuple[float, float]
"""Positions (2, 3) of the hands in m, the left one first, or their distance ahead of and above the shoulders."""


def pedestrian(rng: np.random.Generator) -> list[Part]:
    """Return a standing or walking person, some with a bag."""
    tall, stride = rng.uniform(1.55, 1.9), rng.uniform(0.0, 0.28)
    out = _person(rng, tall, [[stride, 0.1, 0.0], [-stride, -0.1, 0.0]], (0.5 * stride, -0.28 * tall))
    if rng.random() < 0.4:
        bag = Material("bag", pick(rng, CLOTH), 0.3, 0.4)
        out.append(Part(_ball(0.17).moved(-0.1, 0.3, 0.9 * (0.5 * tall)), bag, kind=Class.PERSON))
    return out


def holder(rng: np.random.Generator, tall: float, hands: Float) -> list[Part]:
    """Return a person of `tall` metres who stands and holds something in both hands (2, 3), the left one first."""
    grip = join([_ball(0.04).moved(*hand) for hand in hands])
    body = _person(rng, tall, [[0.02, 0.13, 0.0], [-0.03, -0.13, 0.0]], hands, _trousers(rng))
    return [*body, Part(grip, SKIN, kind=Class.PERSON)]


def _person(
    rng: np.random.Generator, tall: float, feet: list[list[float]], hands: _Hands, trousers: Material | None = None
) -> list[Part]:
    """Return a person of `tall` metres with legs down to `feet` (2, 3), the left one first."""
    hip, neck = np.array([0.0, 0.0, 0.5 * tall]), np.array([0.0, 0.0, 0.83 * tall])
    legs = tubes([hip + [0, 0.09, 0], hip - [0, 0.09, 0]], feet, [[0.1, 0.06], [0.1, 0.06]], sides=8)
    body = _upper_body(rng, hip, neck, tall, hands, Class.PERSON)
    return [Part(legs, trousers or _trousers(rng), kind=Class.PERSON), *body]


def _trousers(rng: np.random.Generator) -> Material:
    return Material("trousers", pick(rng, CLOTH), 0.3, 0.35)


def cyclist(rng: np.random.Generator) -> list[Part]:
    """Return a person on a bicycle."""
    hub_back, hub_front = np.array([-0.52, 0.0, 0.34]), np.array([0.52, 0.0, 0.34])
    crank, saddle, head = np.array([-0.08, 0.0, 0.3]), np.array([-0.2, 0.0, 0.95]), np.array([0.42, 0.0, 0.92])
    bars = [(hub_back, crank), (crank, saddle), (hub_back, saddle), (crank, head), (saddle, head), (head, hub_front)]
    frame = tubes(np.array([a for a, _ in bars]), np.array([b for _, b in bars]), 0.02, sides=5)
    handle = tubes([[0.4, -0.28, 1.02], [0.42, 0, 0.92]], [[0.4, 0.28, 1.02], [0.4, 0, 1.02]], 0.016, sides=5)
    turn = 2 * np.pi * np.arange(20) / 20
    rim = stacked(0.33 * np.cos(turn), 0.0, 0.33 * np.sin(turn))
    wheels = [tubes(hub + rim, hub + np.roll(rim, -1, axis=0), 0.022, sides=4) for hub in (hub_back, hub_front)]
    legs = tubes(
        [[-0.18, 0.1, 0.95], [0.14, 0.12, 0.62], [-0.18, -0.1, 0.95], [0.2, -0.12, 0.72]],
        [[0.14, 0.12, 0.62], [-0.06, 0.12, 0.16], [0.2, -0.12, 0.72], [0.02, -0.12, 0.4]],
        [[0.09, 0.07], [0.06, 0.05], [0.09, 0.07], [0.06, 0.05]],
        sides=7,
    )
    hip, neck = np.array([-0.18, 0.0, 0.95]), np.array([0.14, 0.0, 1.5])
    body = _upper_body(rng, hip, neck, 1.72, (0.26, -0.46), Class.CYCLIST)
    solids = ((frame + handle, DARK_STEEL), (join(wheels), RUBBER), (legs, _trousers(rng)))
    return [*built(Class.CYCLIST, *solids), *body]


def _upper_body(
    rng: np.random.Generator, hip: Float, neck: Float, tall: float, hands: _Hands, kind: Class
) -> list[Part]:
    """Return trunk, arms and head."""
    coat = Material("coat", pick(rng, CLOTH), 0.35, 0.4)
    wide = np.array([0.15, 0.15, 0.17, 0.2, 0.2, 0.07]) * tall / 1.7
    rings = [
        circle(1.0, 0.0, 12) * [0.62 * w, w, 1.0] + hip + level * (neck - hip) - [0, 0, 0.06 * (level == 0)]
        for level, w in zip(np.linspace(0, 1, 6), wide, strict=True)
    ]
    shoulder = hip + 0.86 * (neck - hip)
    if isinstance(hands, tuple):
        ahead, up = hands
        hands = shoulder + np.array([[ahead, 0.24, up], [abs(ahead), -0.24, up]])
    arms = tubes([shoulder + [0, 0.21, 0], shoulder + [0, -0.21, 0]], hands, [[0.065, 0.045]] * 2, sides=7)
    hair = Material("hair", (0.03, 0.022, 0.015), 0.3, 0.3)
    skull = neck + [0.02, 0, 0.1 * tall]
    head, mop = _ball(0.105).moved(*skull), _ball(0.112).moved(*(skull + [-0.025, 0, 0.025]))
    return built(kind, (loft(rings) + arms, coat), (head, SKIN), (mop, hair))


def _ball(radius: float) -> Mesh:
    """Return a ball about the origin."""
    polar = np.linspace(-0.96, 0.96, 7) * np.pi / 2
    return loft([circle(radius * np.cos(p), radius * np.sin(p), 10) for p in polar])
