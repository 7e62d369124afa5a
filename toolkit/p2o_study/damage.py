"""Damage for experiments: random circular patches remove a share of the image edges (paper Sec. IV-B)."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
from p2o.arrays import Float, Int
from p2o.features.edges import ImageEdges
from p2o.features.sets import ImageFeatures
from p2o.frames.scale import camera_at_scale
from p2o.geometry.camera import Camera
from p2o.options import Options, validated
from p2o.options import field as option

STAGE = "damage"
"""The stage of a study's options that sets the damage: `options.damage.missing_edges = 0.45`."""
RADIUS_PX = 40.0
"""Radius of a patch; the paper does not state its own."""
# Circles are tried this many at a time; the last batch is cut where the rate is reached.
_BATCH = 32


class Damage(Options):
    """Damage to the features of a row of a study, done between extraction and calibration."""

    missing_edges: float = option(
        0.0, ge=0, le=0.95, help="Share of the image edges that random circular patches remove (paper Sec. IV-B)."
    )
    radius_px: float = option(RADIUS_PX, gt=0, le=1000, help="Radius of a patch.")
    seed: int = option(0, ge=0, help="Seed of the patches; that of the row unless set.")

    def image_features(self, features: ImageFeatures, camera: Camera, name: str) -> ImageFeatures:
        """Return image features without the removed edges; `camera` is that of the frame `name`, at full size."""
        edges = features.edges
        if not self.missing_edges or edges is None:
            return features
        scaled, rng = camera_at_scale(camera), frame_rng(self.seed, name)
        rest = without_patches(edges, scaled.width, scaled.height, self.missing_edges, rng, radius_px=self.radius_px)
        return features.having(rest)


def split_options(options: Mapping[str, Mapping[str, Any]], seed: int) -> tuple[dict[str, Any], Damage]:
    """Return options by stage without those of the damage, and the damage.

    Raises a P2OError for options of the damage that do not exist or are out of bounds.
    """
    rest = {stage: dict(values) for stage, values in options.items() if stage != STAGE}
    return rest, validated(Damage, {"seed": seed, **options.get(STAGE, {})}, STAGE)


def without_patches(
    edges: ImageEdges, width: int, height: int, rate: float, rng: np.random.Generator, *, radius_px: float = RADIUS_PX
) -> ImageEdges:
    """Remove edges within random circles until the share `rate` of them is removed.

    Centres are uniform over the image (`width` x `height` px) extended by the radius, so that the rim loses the same
    share as the middle. The removed share exceeds `rate` by less than the share of one circle. Edges of all directions
    at one pixel are kept or removed together. The order of the remaining edges is kept.
    """
    # Points up to half a pixel outside are clipped to the image, because circles may never cover them.
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


def frame_rng(seed: int, name: str) -> np.random.Generator:
    """Return the random generator of one frame, which depends on seed and name only."""
    digest = hashlib.sha256(name.encode()).digest()
    return np.random.default_rng([seed, *np.frombuffer(digest[:16], "<u4").tolist()])


def _first_circle(uv: Float, centres: Float, radius_px: float) -> Int:
    """Return the number (N,) of the first circle around each point, or how many circles there are."""
    inside = np.square(uv[:, None] - centres).sum(axis=2) < radius_px**2
    return np.where(inside.any(axis=1), inside.argmax(axis=1), len(centres))
