"""Imperfect image edges for experiments: random circle patches take a share of them away (paper Sec. IV-B)."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from p2o.arrays import Float, Int
from p2o.errors import InputError
from p2o.features.edges import ImageEdges
from p2o.features.view import View

RADIUS_PX = 40.0
"""Radius of a patch; the paper does not state its own."""
# Circles are tried this many at a time; the last batch is cut where the rate is reached.
_BATCH = 32


def without_patches(
    edges: ImageEdges, width: int, height: int, rate: float, rng: np.random.Generator, *, radius_px: float = RADIUS_PX
) -> ImageEdges:
    """Return the edges outside of circles that are thrown on the picture until the share `rate` of them is gone.

    Centres are uniform over the picture (`width` x `height` px) grown by the radius, so that its rim loses as much as
    its middle. The last circle may take more than is needed: the share that is gone exceeds `rate` by less than what
    one circle covers. Points of every direction at one pixel stay or go together. The order of the rest is kept.

    Raises InputError for a rate outside [0, 1) or a radius that is not positive.
    """
    if not 0 <= rate < 1 or not radius_px > 0:
        raise InputError(
            "edges cannot be taken away like this",
            where="missing edges",
            expected="a rate in [0, 1) and a radius > 0 px",
            got=f"rate {rate:g}, radius {radius_px:g} px",
        )
    # Points on the rim may lie half a pixel outside, where no circle is sure to come.
    left = np.arange(len(edges))
    uv = np.clip(edges.uv, 0, (width - 1, height - 1))
    wanted = int(np.ceil(rate * len(edges)))
    while len(edges) - len(left) < wanted:
        centres = rng.uniform(-radius_px, (width + radius_px, height + radius_px), (_BATCH, 2))
        first = _first_circle(uv[left], centres, radius_px)
        gone = len(edges) - len(left) + np.cumsum(np.bincount(first, minlength=_BATCH + 1)[:_BATCH])
        used = min(int(np.searchsorted(gone, wanted)) + 1, _BATCH)
        left = left[first >= used]
    keep = np.zeros(len(edges), bool)
    keep[left] = True
    return edges.select(keep)


def patched(view: View, rate: float, radius_px: float, seed: int) -> View:
    """Return the view without the share `rate` of its image edges, seeded by its name (`without_patches`)."""
    edges = view.image.edges
    if rate == 0 or edges is None:
        return view
    rng, camera = frame_rng(seed, view.name), view.camera
    left = without_patches(edges, camera.width, camera.height, rate, rng, radius_px=radius_px)
    return replace(view, image=view.image.having(left))


def frame_rng(seed: int, name: str) -> np.random.Generator:
    """Return the generator of one frame: the same for the same seed and name, in every process and on every machine."""
    digest = hashlib.sha256(name.encode()).digest()
    return np.random.default_rng([seed, *np.frombuffer(digest[:16], "<u4").tolist()])


def _first_circle(uv: Float, centres: Float, radius_px: float) -> Int:
    """Return the number (N,) of the first circle around each point, or how many circles there are."""
    inside = np.square(uv[:, None] - centres).sum(axis=2) < radius_px**2
    return np.where(inside.any(axis=1), inside.argmax(axis=1), len(centres))
