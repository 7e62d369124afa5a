"""Particle swarm in a box around the initial pose, after Taylor and Nieto; every population is one call of the cost.

A swarm is initialised uniformly in the box, with one particle at the centre; each particle is attracted to its own best
position and to that of all (inertia 0.72, attraction 1.49 each: Clerc's constriction). When its iterations are used, or
the swarm has collapsed, the next one searches a smaller box around the best position, as in the paper. Numbers of
particles and boxes and the shrink factor are ours: those of the paper are not known to us.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o.solving import swarmed

from p2o_plugins.solve.scalar_cost import ScalarCost, scalar_solver

_SHRINK = 0.3  # factor on the size from box to box
_INERTIA = 0.72  # share of its velocity that a particle keeps
_ATTRACTION = 1.49  # attraction to the best position of a particle, and to that of all
_COLLAPSED = 0.01  # stop a swarm at this width, as a share of its box
_BOXES = 3  # boxes that are searched in sequence, each around the best pose so far


class ParticleSwarmOptions(p2o.Options):
    """Options of `particle-swarm`."""

    box_deg: float = p2o.field(3.0, gt=0, le=90, help="Search range of each rotation around the initial pose.")
    box_m: float = p2o.field(0.3, gt=0, le=100, help="Search range of each translation around the initial pose.")
    particles: int = p2o.field(100, ge=2, le=100_000, help="Particles of a swarm.")
    iterations: int = p2o.field(60, ge=1, help="Moves of the swarms in all boxes together.")
    seed: int = p2o.field(0, ge=0, help="Random seed.")


def build(options: ParticleSwarmOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""

    def minimise(cost: ScalarCost) -> p2o.Solution:
        rng = np.random.default_rng(options.seed)
        best, moves = np.zeros(6), 0
        for number in range(_BOXES):
            size = _SHRINK**number
            # The box never leaves the first one, which is from -1 to 1 in every unknown.
            best, _, moved = swarmed(
                cost.many,
                np.maximum(best - size, -1.0),
                np.minimum(best + size, 1.0),
                rng,
                first=best,
                particles=options.particles,
                moves=options.iterations * (number + 1) // _BOXES - options.iterations * number // _BOXES,
                inertia=_INERTIA,
                attraction=_ATTRACTION,
                narrow=_COLLAPSED * 2 * size,
            )
            moves += moved
        return cost.solution(best, moves, converged=True)

    return scalar_solver(minimise, options.box_deg, options.box_m)


METHOD = p2o.Method(
    name="particle-swarm",
    build=build,
    options=ParticleSwarmOptions,
    summary="Particle swarm in a shrinking box around the start, on any scalar cost; seeded.",
    needs={"objective"},
    cite="Kennedy and Eberhart, ICNN 1995; Clerc and Kennedy, IEEE Transactions on Evolutionary Computation 6, 2002; "
    "Taylor and Nieto, ICRA 2013",
)
