"""A flat road without anything beside it, and the same with traffic: few edges, or only edges of moving things."""

from __future__ import annotations

from p2o_sim.places.repeated import open_ground
from p2o_sim.things.vehicles import traffic
from p2o_sim.world.place import Layout, Plan, backdrop


def layout(plan: Plan) -> Layout:
    """Return a road to the horizon, with distant woods around."""
    return Layout([open_ground(plan), *backdrop(plan)], [], [], (0.0, 0.0))


def traffic_layout(plan: Plan) -> Layout:
    """Return the road with traffic on four lanes; nothing else is above the ground."""
    bare, far = layout(plan), plan.travel_m + 90.0
    oncoming = [
        thing for y in (3.5, 7.0) for thing in traffic(plan, 0.2, y, 10.0, far + 80.0, (9.0, 25.0), yaw_deg=180.0)
    ]
    ahead = traffic(plan, 0.2, 0.0, 14.0, far, (14.0, 30.0)) + traffic(plan, 0.2, -3.5, 7.0, far, (9.0, 25.0))
    return Layout(bare.things, oncoming, ahead, bare.curvature)
