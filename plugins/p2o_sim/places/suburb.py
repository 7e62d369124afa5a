"""A street of a suburb: villas behind hedges, fences and trees, and a few parked cars."""

from __future__ import annotations

from p2o_sim.things.buildings import villa
from p2o_sim.things.furniture import clutter, fence, lamp, pole, sign, wires
from p2o_sim.things.ground import dashes, kerbed_street, land, stations
from p2o_sim.things.people import cyclist, pedestrian
from p2o_sim.things.plants import bush, hedge, tree, tufts
from p2o_sim.things.vehicles import any_vehicle, traffic
from p2o_sim.world.mesh import stacked
from p2o_sim.world.place import BEHIND_M, Layout, Plan, Thing, backdrop, on_side, placed


def layout(plan: Plan) -> Layout:
    """Return a quiet street with gardens on both sides."""
    rng = plan.rng
    right, left = -rng.uniform(2.6, 4.2), rng.uniform(4.6, 6.0)
    edge = (right - rng.uniform(1.6, 2.6), left + rng.uniform(1.6, 2.6))
    x = stations(BEHIND_M, plan.far_m)
    ground = kerbed_street(x, edge, right, left, 0.12, (0.11, 0.12))
    ground += [land(rng, x, edge[1], 0.12, 1, rough=0.06), land(rng, x, edge[0], 0.12, -1, rough=0.06)]
    if rng.random() < 0.4:
        ground.append(dashes(BEHIND_M, plan.far_m, 1.5, period=6.0))
    things: list[Thing] = [ground, *backdrop(plan, high=(6.0, 12.0))]
    for side, line in ((-1, edge[0]), (1, edge[1])):
        things += _gardens(plan, side, line)
        kerb = right if side < 0 else left
        for at in plan.along(-20.0, plan.travel_m + 110.0, (9.0, 24.0)):
            if not -6.0 < at < 6.0:
                yaw = (0.0 if side < 0 else 180.0) + rng.uniform(-2, 2)
                y = kerb - side * 0.5 if side > 0 else kerb - 0.9
                things.append(placed(any_vehicle(rng, 0.02), at, y, 0.05, yaw_deg=yaw))
        for at in plan.along(-15.0, plan.travel_m + 90.0, (7.0, 16.0)):
            things.append(_roadside(plan, side, kerb, line, at))
    if rng.random() < 0.5:
        things.append(placed(wires(plan.far_m, edge[1] + 0.3, 6.0), 0.0, 0.0))
    oncoming = traffic(plan, 0.05, 3.0, 25.0, 90.0 + plan.travel_m, (30.0, 80.0), yaw_deg=180.0)
    ahead = traffic(plan, 0.05, 0.0, rng.uniform(14.0, 45.0), 60.0, (30.0, 60.0))
    return Layout(things, oncoming, ahead, (-0.008, 0.008))


def _gardens(plan: Plan, side: int, line: float) -> list[Thing]:
    """Return, behind the garden line, a hedge or fence, a villa and trees, plot after plot."""
    rng, out = plan.rng, []
    x = BEHIND_M + rng.uniform(0, 6)
    while x < plan.travel_m + 130.0:
        plot = rng.uniform(13.0, 22.0)
        sight = plan.sight_m(x + plot / 2, line)
        border = rng.random()
        gate = rng.uniform(2.5, 4.0)
        if border < 0.55:
            out.append(placed(hedge(rng, plot - gate, sight), x, line + side * 0.6))
        elif border < 0.9:
            out.append(placed(fence(rng, plot - gate), x, line + side * 0.2))
        house, length = villa(rng, plot * 0.6), plot * 0.6
        out.append(on_side(house, side, x + 2, line + side * rng.uniform(4.5, 9.0), length))
        for _ in range(rng.integers(1, 4)):
            at, off = x + rng.uniform(0, plot), rng.uniform(1.6, 4.2)
            seen = plan.sight_m(at, line + side * off)
            plant = tree(rng, seen, height=rng.uniform(4.0, 9.0)) if rng.random() < 0.6 else bush(rng, seen)
            out.append(placed(plant, at, line + side * off, 0.1))
        if rng.random() < 0.4:
            tall = tree(rng, 40.0, height=rng.uniform(8.0, 14.0))
            out.append(placed(tall, x + rng.uniform(0, plot), line + side * 20.0))
        x += plot
    blades = rng.uniform(0, plan.travel_m + 30, 500), line + side * rng.uniform(0.05, 0.5, 500)
    return [*out, tufts(rng, stacked(*blades, 0.1), 0.18)]


def _roadside(plan: Plan, side: int, kerb: float, line: float, x: float) -> Thing:
    rng = plan.rng
    near, inside = kerb + side * 0.35, kerb + side * rng.uniform(0.7, abs(line - kerb) - 0.4)
    draw, turn = rng.random(), 0.0 if side < 0 else 180.0
    if draw < 0.25:
        return placed(lamp(rng, high=rng.uniform(4.0, 6.5)), x, near, 0.1, yaw_deg=turn)
    if draw < 0.5:
        return placed(sign(rng), x, near, 0.1, yaw_deg=turn + rng.uniform(-15, 15))
    if draw < 0.62:
        return placed(pedestrian(rng), x, inside, 0.12, yaw_deg=rng.uniform(0, 360))
    if draw < 0.7:
        return placed(cyclist(rng), x, inside, 0.12, yaw_deg=turn)
    if draw < 0.82:
        return placed(pole(rng), x, near, 0.1)
    if draw < 0.9:
        return placed(tree(rng, plan.sight_m(x, near), height=rng.uniform(4.0, 7.0)), x, near, 0.1)
    return placed(clutter(rng), x, inside, 0.12, yaw_deg=90.0)
