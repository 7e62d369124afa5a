"""Which ball of a sweep is which of its picture: the choice that one rigid pose explains in most frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.closed_form import turned
from p2o_baselines.bodies.sphere_in_picture import SphereInPicture
from p2o_baselines.bodies.sphere_in_sweep import SphereInSweep

_LEVER_M = 3.0  # sensors are no farther apart, so a ball is about as far from both
_MOST_TRIPLES = 20_000
_LEAST_HEIGHT_M = 0.15  # of a triangle of middles: less is three on a line


@dataclass(frozen=True)
class SphereSight:
    """One frame: `asked` says which balls were looked for, `pictures` and `sweeps` what was found."""

    name: str
    asked: str
    pictures: tuple[SphereInPicture, ...]
    sweeps: tuple[SphereInSweep, ...]


@dataclass(frozen=True)
class SpherePair:
    """A ball of a picture with that of the sweep; `frame` is the number of its frame."""

    frame: int
    picture: SphereInPicture
    sweep: SphereInSweep


def from_points(to: Float, of: Float) -> Float:
    """Return the pose (4, 4) that takes points (N, 3) nearest to others; least squares."""
    rotation = turned(to - to.mean(axis=0), of - of.mean(axis=0))
    return se3.make(rotation, to.mean(axis=0) - rotation @ of.mean(axis=0))


def paired_spheres(sights: Sequence[SphereSight], seed: int = 0) -> tuple[tuple[SpherePair, ...], Float | None]:
    """Return the pairs that most frames agree on, and that pose (4, 4); None where no three make one."""
    choices = [
        SpherePair(number, picture, sweep)
        for number, sight in enumerate(sights)
        for picture in sight.pictures
        for sweep in sight.sweeps
        if picture.target.radius_m == sweep.radius_m
        and abs(np.linalg.norm(picture.centre) - np.linalg.norm(sweep.centre)) < _LEVER_M
    ]
    if len(choices) < 3:
        return (), None
    to, of = np.array([c.picture.centre for c in choices]), np.array([c.sweep.centre for c in choices])
    off_m = np.array([_depth_m(c.picture) for c in choices])
    best: tuple[int, float, Float] | None = None
    for three in _triples(len(choices), seed):
        index = np.array(three)
        if len({id(choices[k].picture) for k in three}) < 3 or len({id(choices[k].sweep) for k in three}) < 3:
            continue
        sides = [np.linalg.norm(np.roll(p[index], 1, axis=0) - p[index], axis=1) for p in (to, of)]
        if (np.abs(sides[0] - sides[1]) > 2 * off_m[index].max()).any() or _height_m(of[index]) < _LEAST_HEIGHT_M:
            continue
        pose = from_points(to[index], of[index])
        for _ in range(2):
            off = np.linalg.norm(se3.apply(pose, of) - to, axis=1) / off_m
            near = _once(choices, off)
            if len(near) >= 3 and _height_m(of[near]) >= _LEAST_HEIGHT_M:
                pose = from_points(to[near], of[near])
        off = np.linalg.norm(se3.apply(pose, of) - to, axis=1) / off_m
        near = _once(choices, off)
        rank = (len(near), -float(np.sum(off[near] ** 2)))
        if len(near) >= 3 and (best is None or rank > best[:2]):
            best = (*rank, pose)
            if len(near) == len({(c.frame, id(c.picture)) for c in choices}):
                break
    if best is None:
        return (), None
    off = np.linalg.norm(se3.apply(best[2], of) - to, axis=1) / off_m
    return tuple(choices[k] for k in _once(choices, off)), best[2]


def _depth_m(ball: SphereInPicture) -> float:
    """Return how far a ball's middle may be off: half a pixel of its radius moves it in depth, and 5 cm."""
    return float(np.linalg.norm(ball.centre)) * 0.5 / (ball.half_rad * ball.px_per_rad) + 0.05


def _height_m(points: Float) -> float:
    """Return how far points (N, 3) reach from the line nearest to them, root mean square."""
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points)))


def _once(choices: Sequence[SpherePair], off: Float) -> list[int]:
    """Return which choices are near enough, each ball used once, nearest first."""
    used: set[int] = set()
    out = []
    for at in np.argsort(off, kind="stable"):
        if off[at] >= 1:
            break
        ids = {id(choices[at].picture), id(choices[at].sweep)}
        if not ids & used:
            used |= ids
            out.append(int(at))
    return sorted(out)


def _triples(count: int, seed: int) -> list[tuple[int, ...]]:
    if count <= 40:
        every = list(combinations(range(count), 3))
        np.random.default_rng(seed).shuffle(every)
        return every
    rng = np.random.default_rng(seed)
    return [tuple(rng.choice(count, 3, replace=False).tolist()) for _ in range(_MOST_TRIPLES)]
