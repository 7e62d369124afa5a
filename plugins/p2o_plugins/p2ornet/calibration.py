"""Verdicts on detected edges from labels, and the calibrated confidence that follows from them."""

from __future__ import annotations

import numpy as np
from p2o import SIDES, Bool, Float, Side
from scipy import ndimage, optimize

from p2o_plugins.p2ornet.augment import draw
from p2o_plugins.p2ornet.example import UNKNOWN, Example
from p2o_plugins.p2ornet.spans import AXIS, EAST, ORDER
from p2o_plugins.p2ornet.thinning import Peaks

SLACK = 1
"""Pairs by which a peak may miss its labelled place and still be right."""


def verdicts(edges: Peaks, example: Example) -> tuple[Float, Bool]:
    """Return the scores (M,) of the peaks with a known verdict, and whether these are right (M,).

    Right: a labelled occlusion of the direction is within SLACK pairs, or the peak lies in a span that contains one.
    Wrong: the pair is labelled as no occlusion of this direction. All others are ignored.
    """
    height, width = example.rgb.shape[:2]
    classes = np.full((2, height, width), UNKNOWN, np.int8) if example.classes is None else example.classes.copy()
    bags, bag_class, _ = draw(example.spans, classes)
    scores, right = [], []
    for side in SIDES:
        axis, wanted = AXIS[side], ORDER[side] + 1
        occluded = classes[axis] == wanted
        rows = bags[(bag_class == wanted) & (bags[:, 0] // (height * width) == axis)]
        flat = rows[rows >= 0] - axis * height * width
        occluded.reshape(-1)[flat] = True
        along = np.ones((1, 2 * SLACK + 1) if axis == EAST else (2 * SLACK + 1, 1), np.bool_)
        occluded = ndimage.binary_dilation(occluded, structure=along)
        labelled = occluded | (classes[axis] != UNKNOWN)
        chosen = edges.side == side
        u, v = edges.pixel[chosen].T.astype(np.int64)
        # The pair is stored at its left or upper pixel, which is the background's for L and U edges.
        u, v = u - (side == Side.LEFT), v - (side == Side.UPPER)
        keep = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        keep[keep] = labelled[v[keep], u[keep]]
        scores.append(edges.score[chosen][keep])
        right.append(occluded[v[keep], u[keep]])
    return np.concatenate(scores), np.concatenate(right)


def fit(score: Float, right: Bool) -> tuple[float, float]:
    """Return slope > 0 and offset of the confidence 1 / (1 + exp(-(slope * logit(score) + offset))) (Platt, 1999)."""
    s = np.clip(score, 1e-4, 1 - 1e-4)
    logit = np.log(s / (1 - s))

    def loss(x: Float) -> float:
        z = np.exp(x[0]) * logit + x[1]
        return float(np.mean(np.logaddexp(0, -z) * right + np.logaddexp(0, z) * ~right))

    optimum = optimize.minimize(loss, np.zeros(2), method="Nelder-Mead")
    return float(np.exp(optimum.x[0])), float(optimum.x[1])
