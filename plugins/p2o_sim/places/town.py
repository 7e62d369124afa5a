"""A street of a town: terraces, parked cars, trees in the pavement, signs, lights and people."""

from __future__ import annotations

from p2o_sim.things.buildings import block, town_house
from p2o_sim.things.furniture import barrier, clutter, lamp, pole, shelter, sign, traffic_light, wires
from p2o_sim.things.ground import dashes, kerbed_street, land, stations, stop_line
from p2o_sim.things.people import cyclist, pedestrian
from p2o_sim.things.plants import bush, hedge, tree
from p2o_sim.things.vehicles import any_vehicle, bus, traffic
from p2o_sim.world.place import BEHIND_M, Layout, Plan, Thing, backdrop, on_side, placed


def layout(plan: Plan) -> Layout:
    """Return a street with a lane each way and cars parked on both sides."""
    rng = plan.rng
    right, left = -rng.uniform(4.3, 5.2), rng.uniform(6.2, 8.0)
    walk = rng.uniform(2.6, 4.5, 2)
    fronts = (right - walk[0], left + walk[1])
    close = plan.travel_m + rng.uniform(70.0, 140.0)
    x = stations(BEHIND_M, plan.far_m)
    ground = kerbed_street(x, (fronts[0] - 1, fronts[1] + 1), right, left, 0.15, (0.12, 0.13))
    ground += [land(rng, x, fronts[1] + 1, 0.13, 1, rough=0.05), land(rng, x, fronts[0] - 1, 0.13, -1, rough=0.05)]
    ground.append(dashes(BEHIND_M, close, 1.75, period=rng.choice([3.0, 6.0])))
    things: list[Thing] = [ground, *backdrop(plan)]
    things += _front(plan, -1, fronts[0], close) + _front(plan, 1, fronts[1], close)
    things += _close(plan, close)
    things += _parked(plan, right, left, close)
    things += _pavement(plan, -1, right, fronts[0], close) + _pavement(plan, 1, left, fronts[1], close)
    if rng.random() < 0.5:
        at = plan.travel_m + rng.uniform(14.0, 35.0)
        things.append([stop_line(at, right + 0.3, 1.7)])
        things.append(placed(traffic_light(rng), at + 1, right - 0.6, 0.1))
        things.append(placed(traffic_light(rng), at + 16, left + 0.6, 0.1, yaw_deg=180.0))
    if rng.random() < 0.3:
        things.append(placed(wires(close, 0.5, 6.4), 0.0, 0.0))
    oncoming = traffic(plan, 0.12, 3.3, 18.0, close - 10 + plan.travel_m, (16.0, 50.0), yaw_deg=180.0)
    ahead = traffic(plan, 0.12, 0.0, rng.uniform(12.0, 24.0), 60.0, (15.0, 40.0))
    return Layout(things, oncoming, ahead, (-0.005, 0.005))


def _front(plan: Plan, side: int, front: float, close: float) -> list[Thing]:
    """Return the houses of one side, with gaps of hedges and trees."""
    rng, out = plan.rng, []
    x = BEHIND_M + rng.uniform(0.0, 8.0)
    while x < close - 6.0:
        if rng.random() < 0.2:
            length = rng.uniform(5.0, 12.0)
            sight = plan.sight_m(x + length, front)
            out.append(placed(hedge(rng, length, sight), x, front + side * 0.6))
            out += [
                placed(tree(rng, plan.sight_m(x, front)), x + share * length, front + side * rng.uniform(2.5, 7.0))
                for share in rng.uniform(0, 1, 2)
            ]
        else:
            length = rng.uniform(8.0, 15.0)
            y = front + side * rng.choice([0.0, 0.0, 0.6, 2.2])
            out.append(on_side(town_house(rng, length), side, x, y, length))
        x += length + (rng.uniform(1.0, 4.0) if rng.random() < 0.2 else 0.0)
    return out


def _close(plan: Plan, close: float) -> list[Thing]:
    """Return the end of the street: houses across, trees in front of them."""
    rng, out = plan.rng, []
    for y in plan.along(-34.0, 34.0, (11.0, 20.0)):
        house = town_house(rng, 10.0) if rng.random() < 0.6 else block(rng, 16.0)
        out.append(placed(house, close + rng.uniform(10.0, 40.0), y + 5.0, yaw_deg=-90.0))
    out += [placed(tree(rng, 90.0), close + rng.uniform(2.0, 8.0), y) for y in plan.along(-26.0, 26.0, (6.0, 14.0))]
    return out


def _parked(plan: Plan, right: float, left: float, close: float) -> list[Thing]:
    rng, out = plan.rng, []
    for y, start, facing in ((right + 1.05, 6.5, 0.0), (left - 1.05, 4.5, 180.0)):
        out += [
            placed(any_vehicle(rng, 0.03), x, y + rng.uniform(-0.12, 0.12), yaw_deg=facing + rng.uniform(-2.5, 2.5))
            for x in plan.along(start - 40.0, close - 5.0, (6.2, 17.0))
            if not -6.0 < x < start - 1.0
        ]
    if rng.random() < 0.15:
        out.append(placed(bus(rng), close + 4.0, 2.0, yaw_deg=90.0))
    return out


def _pavement(plan: Plan, side: int, kerb: float, front: float, close: float) -> list[Thing]:
    rng, out = plan.rng, []
    room = abs(front - kerb)
    for x in plan.along(-20.0, close, (2.6, 6.5)):
        near_kerb, inside = kerb + side * rng.uniform(0.35, 0.6), kerb + side * rng.uniform(0.9, room - 0.7)
        draw, yaw = rng.random(), rng.uniform(-12.0, 12.0)
        if -3.0 < x < 3.0 and abs(kerb) < 5.0:
            continue
        turn = 0.0 if side < 0 else 180.0
        if draw < 0.15:
            thing = placed(lamp(rng), x, near_kerb, 0.1, yaw_deg=turn)
        elif draw < 0.36:
            thing = placed(sign(rng), x, near_kerb, 0.1, yaw_deg=turn + yaw)
        elif draw < 0.54:
            thing = placed(tree(rng, plan.sight_m(x, near_kerb), height=rng.uniform(4.5, 8.5)), x, near_kerb, 0.1)
        elif draw < 0.70:
            thing = placed(pedestrian(rng), x, inside, 0.13, yaw_deg=rng.choice([0.0, 180.0]) + 2 * yaw)
        elif draw < 0.78:
            thing = placed(cyclist(rng), x, kerb - side * 0.7 if rng.random() < 0.3 else inside, 0.0, yaw_deg=yaw)
        elif draw < 0.82:
            thing = placed(barrier(rng), x, inside, 0.13, yaw_deg=yaw)
        elif draw < 0.85 and room > 3.0:
            thing = placed(shelter(rng), x, front - side * 0.9, 0.13, yaw_deg=180.0 - turn)
        elif draw < 0.9:
            thing = placed(bush(rng, plan.sight_m(x, inside), radius=rng.uniform(0.4, 0.7)), x, inside, 0.13)
        elif draw < 0.94:
            thing = placed(pole(rng), x, near_kerb, 0.1)
        else:
            thing = placed(clutter(rng), x, inside, 0.13, yaw_deg=90.0)
        out.append(thing)
    return out
