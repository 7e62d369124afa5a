"""Particle swarm in a box around the start, as Taylor and Nieto search: every population is one call of the cost.

A swarm begins spread over the box, one particle at the centre; each particle is drawn to its own best place and to
that of all (inertia 0.72, attraction 1.49 each: Clerc's constriction). When its share of iterations is spent, or the
swarm has collapsed, the next one searches a smaller box around the best place, as in the paper. Numbers of particles,
of boxes and by how much they shrink are ours: the paper's are not known to us.
"""

from __future__ import annotations

import numpy as np
import p2o
from p2o.arrays import Float
from p2o.problems.swarm import swarmed

from p2o_plugins.solve.scalar_cost import ScalarCost


class ParticleSwarmOptions(p2o.Options):
    """Options of `particle-swarm`."""

    box_deg: float = p2o.field(3.0, gt=0, le=90, help="Each rotation is sought this near to the start.")
    box_m: float = p2o.field(0.3, gt=0, le=100, help="Each translation is sought this near to the start.")
    particles: int = p2o.field(100, ge=2, le=100_000, help="Particles of a swarm.")
    iterations: int = p2o.field(60, ge=1, help="Moves of the swarms, shared among all boxes.")
    boxes: int = p2o.field(3, ge=1, le=20, help="Boxes that are searched one after another, each around the best yet.")
    shrink: float = p2o.field(0.3, gt=0, lt=1, help="Factor on the size from box to box.")
    inertia: float = p2o.field(0.72, ge=0, lt=1, help="Share of its velocity that a particle keeps.")
    attraction: float = p2o.field(1.49, gt=0, le=4, help="Pull to the best place of a particle, and to that of all.")
    collapsed: float = p2o.field(0.01, ge=0, lt=1, help="A swarm that is this share of its box wide has done its work.")
    seed: int = p2o.field(0, ge=0, help="Seed of all draws.")


def build(options: ParticleSwarmOptions) -> p2o.Solver:
    """Return the solver `(Problem, camera_from_lidar (4, 4)) -> Solution`."""

    def solve(problem: p2o.Problem, camera_from_lidar: Float) -> p2o.Solution:
        start = np.asarray(camera_from_lidar, dtype=np.float64)
        cost = ScalarCost(problem, start, options.box_deg, options.box_m)
        hopeless = cost.unsolvable()
        if hopeless is not None:
            return hopeless
        rng = np.random.default_rng(options.seed)
        best, moves = np.zeros(6), 0
        for number in range(options.boxes):
            share = options.iterations * (number + 1) // options.boxes - options.iterations * number // options.boxes
            best, moved = swarm(cost, best, options.shrink**number, share, rng, options)
            moves += moved
        return cost.solution(best, moves, converged=True)

    return solve


def swarm(
    cost: ScalarCost,
    centre: Float,
    size: float,
    iterations: int,
    rng: np.random.Generator,
    options: ParticleSwarmOptions,
) -> tuple[Float, int]:
    """Return the best place (6,) that one swarm finds in a box of half side `size` around `centre` (6,), and its moves.

    The box never leaves the first one, which is from -1 to 1 in every unknown.
    """
    best, _, moved = swarmed(
        cost.many,
        np.maximum(centre - size, -1.0),
        np.minimum(centre + size, 1.0),
        rng,
        first=centre,
        particles=options.particles,
        moves=iterations,
        inertia=options.inertia,
        attraction=options.attraction,
        narrow=options.collapsed * 2 * size,
    )
    return best, moved


METHOD = p2o.Method(
    name="particle-swarm",
    build=build,
    options=ParticleSwarmOptions,
    summary="Particle swarm in a shrinking box around the start, on any scalar cost; seeded.",
    needs={"objective"},
    cite="Kennedy and Eberhart, ICNN 1995; Clerc and Kennedy, IEEE Transactions on Evolutionary Computation 6, 2002; "
    "Taylor and Nieto, ICRA 2013",
)
