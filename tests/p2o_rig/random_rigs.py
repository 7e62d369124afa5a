"""Random rigs: true poses of LiDARs and cameras, and measured edges between them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from p2o import Float, se3
from p2o_rig.sensor_graph import Edge, EdgeKind

RESULT_SIGMA = (0.15, 0.03)
SWEEPS_SIGMA = (0.03, 0.005)


@dataclass(frozen=True)
class RandomRig:
    """True poses `reference_from_sensor` (4, 4), the reference is `lidar0`, and edges between all pairs."""

    truth: Mapping[str, Float]
    edges: tuple[Edge, ...]

    def true(self, parent: str, child: str) -> Float:
        return se3.inverse(self.truth[parent]) @ self.truth[child]


def random_covariance(rng: np.random.Generator, sigma_deg: float, sigma_m: float) -> Float:
    mixed = rng.normal(size=(6, 6))
    scale = np.repeat([np.radians(sigma_deg), sigma_m], 3)
    return np.asarray(scale[:, None] * (0.5 * np.eye(6) + mixed @ mixed.T / 12) * scale)


def measured(
    rig: Mapping[str, Float], parent: str, child: str, covariance: Float, kind: EdgeKind, rng: np.random.Generator,
    noise: float = 1.0, trusted: bool = True,
) -> Edge:  # fmt: skip
    """Return the edge of a pair with an error drawn from its covariance, times `noise`."""
    step = noise * np.linalg.cholesky(covariance) @ rng.standard_normal(6)
    return Edge(parent, child, se3.exp(step) @ se3.inverse(rig[parent]) @ rig[child], covariance, kind, trusted)


def random_rig(rng: np.random.Generator, lidars: int, cameras: int, noise: float = 1.0) -> RandomRig:
    """Draw poses, and an edge between each camera and each LiDAR and between each two LiDARs."""
    names = [f"lidar{i}" for i in range(lidars)], [f"camera{i}" for i in range(cameras)]
    truth = {name: se3.exp(rng.normal(size=6)) for group in names for name in group}
    truth = {name: se3.inverse(truth["lidar0"]) @ pose for name, pose in truth.items()}
    pairs = [(camera, lidar, EdgeKind.RESULT, RESULT_SIGMA) for camera in names[1] for lidar in names[0]]
    pairs += [
        (first, second, EdgeKind.SWEEPS, SWEEPS_SIGMA)
        for number, first in enumerate(names[0])
        for second in names[0][number + 1 :]
    ]
    edges = [
        measured(truth, parent, child, random_covariance(rng, *sigma), kind, rng, noise)
        for parent, child, kind, sigma in pairs
    ]
    return RandomRig(truth, tuple(edges))


def displaced(edge: Edge, angle_deg: float, distance_m: float, rng: np.random.Generator, trusted: bool = True) -> Edge:
    """Return the edge with an additional error of this size in a random direction."""
    step = rng.normal(size=6)
    step[:3] *= np.radians(angle_deg) / np.linalg.norm(step[:3])
    step[3:] *= distance_m / np.linalg.norm(step[3:])
    pose = se3.exp(step) @ edge.parent_from_child
    return Edge(edge.parent, edge.child, pose, edge.covariance, edge.kind, trusted, edge.source)
