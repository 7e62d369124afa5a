"""Locate silhouettes at the image gradient where the assignment changes from foreground to background disparity.

Windows of stereo matchers extend the foreground's disparity one or two pixels beyond its outline. In this module the
disparity step gives only the approximate place of an edge and its two disparities. Both disparities are then evaluated
pixel by pixel in the other image, without a window across the edge; along the axis of the edge the sum of both costs
has its minimum at the end of the foreground. Only colour changes are candidates, which gives sub-pixel places.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from p2o import Bool, Float, Int, Side

from p2o_plugins.image.disparity import Map, PairView

REACH = 5
"""Search range of a silhouette around the disparity step, in px."""
WINDOW = 5
"""Depth of the strips in foreground and background in which the two disparities are compared, in px."""
BREADTH = 4
"""Length of the window along the edge, to both sides, whose pixels vote on the two disparities, in px."""
MIN_KNOWN = 0.5
"""Minimum fraction of the pixels in the window inside an edge at which both views agree on the disparity."""
SPAN = REACH + WINDOW

PRIOR = {
    (1, 0): (0.15, 5.0, 0.03),
    (0, -1): (-0.2, 7.0, 0.06),
    (0, 1): (0.25, 7.0, 0.03),
}
"""By the step (du, dv) to the background: cost per pixel outwards, weight of the contrast, weight of the step.

A textureless strip along the edge fits both disparities. Below and beside an object such a strip is usually road or a
blurred border: ties are resolved to the inner place. Above an object it is usually the roof of a car over its windows:
ties are resolved to the outer place. Tuned on layered pairs synthesised from images of the `train` split.
"""

_ACROSS = (
    (4.76, 1.63, -0.16, 0.25, -0.50, 1.91, 0.31, 2.25, 1.51, -0.71, -3.77, -0.03, 0.27, -2.76),
    (0.74, 2.13, -0.84),
)
JUDGEMENT = {
    Side.LEFT: _ACROSS,
    Side.RIGHT: _ACROSS,
    Side.UPPER: (
        (3.91, 1.20, -0.10, 0.44, 0.70, 0.95, 0.91, 0.73, 0.44, -1.90, 0.81, 0.73, 0.31, -4.92),
        (0.70, 1.70, -0.65),
    ),
    Side.BOTTOM: (
        (3.49, 0.88, -0.08, 0.71, -1.15, 0.36, 1.30, 1.72, 0.20, -1.23, 1.01, 4.89, -0.17, -8.12),
        (0.52, 3.62, -1.28),
    ),
}
"""Coefficients of `confidence` for the directions; L and R are mirror images and share theirs.

Those of the features contrast, lead, shift, jump, ratio, votes inside and outside, near votes inside and outside,
misfit inside and outside, known inside and outside (see `locate`), and a constant; then those of the first estimate, of
the neighbours' estimates, and a constant.

Logistic regression on layered pairs synthesised from images of the `train` split: `benchmarks/stereo_bias.py
--fit` of commit `3c814d5`.
"""


@dataclass(frozen=True, eq=False)
class Silhouettes:
    """Silhouette points of one direction: `uv` (N, 2) px, `disparity` (N,) px of the foreground.

    `features` (N, 13) as listed at JUDGEMENT, each of order one.
    """

    uv: Float
    disparity: Float
    features: Float

    def select(self, keep: Bool) -> Silhouettes:
        """Return the silhouettes of a mask (N,)."""
        return Silhouettes(self.uv[keep], self.disparity[keep], self.features[keep])

    def pixels(self, towards: tuple[int, int], inside_px: float = 0.5) -> Int:
        """Return pixels (N, 2) of the foreground, `inside_px` from a background in the direction `towards` (du, dv)."""
        return (self.uv - inside_px * np.array(towards)).round().astype(np.int64)


def steps(disparity: Map, towards: tuple[int, int], min_jump_px: float, min_jump_ratio: float) -> tuple[Int, Int]:
    """Return rows and columns of the last foreground pixels before the disparity drops in direction `towards` (du, dv).

    The drop over 3 px must exceed `min_jump_px` and the given fraction of the foreground's disparity; it must be the
    steepest place within 3 px; the disparity must not still increase in the foreground nor continue to decrease in the
    background (a slanted surface).
    """
    axis, sign = (1, towards[0]) if towards[0] else (0, towards[1])

    def at(array: Map, k: int) -> Map:
        return np.roll(array, -k * sign, axis)

    jump = at(disparity, -1) - at(disparity, 2)
    fall = disparity - at(disparity, 1)
    drop = (jump > min_jump_px) & (jump > min_jump_ratio * at(disparity, -1)) & (fall > 0)
    for k in (1, 2, 3):
        drop &= (fall > at(fall, -k)) & (fall >= at(fall, k))
    drop &= (at(disparity, -5) - at(disparity, -1) < 0.3 * jump) & (at(disparity, 2) - at(disparity, 6) < 0.6 * jump)
    # np.roll wraps around, so that values this close to the border are invalid.
    drop[:8], drop[-8:], drop[:, :8], drop[:, -8:] = False, False, False, False
    v, u = np.nonzero(drop)
    return v, u


def locate(view: PairView, v: Int, u: Int, towards: tuple[int, int]) -> Silhouettes:
    """Return the silhouettes near the last foreground pixels (v, u) with the background `towards` (du, dv).

    Points without a colour change within REACH, or whose foreground fails the left-right check, are omitted. Features:
    `contrast` of the colours; `lead` over the second best place; `shift` from the disparity step; `jump` and its
    `ratio` to the foreground's disparity; on each side, in a window and close to the edge, the majority of pixels that
    prefer the disparity of their own side (`votes`), the mean cost of the right disparity (`misfit`), and the fraction
    of pixels at which both views agree (`known`).
    """
    du, dv = towards
    k = np.arange(-SPAN, SPAN + 1)
    rows, columns = _window(view, v, u, towards, k)
    own = view.own[rows, columns]
    profile = view.disparity[rows[:, :, BREADTH], columns[:, :, BREADTH]]
    front = _extended(profile[:, SPAN - 4 : SPAN + 1], -2, k)
    back = _extended(profile[:, SPAN + 1 : SPAN + 6], 3, k)
    cost_front = _cost(view, own, rows, columns - front[:, :, None])
    cost_back = _cost(view, own, rows, columns - back[:, :, None])

    change = np.abs(np.diff(own[:, :, BREADTH - 1 : BREADTH + 2, :3].mean(2), axis=1))
    contrast = np.sqrt((change**2).sum(2))
    place, best, lead = _split(cost_front - cost_back, contrast, k, PRIOR[towards])
    known = view.known[rows, columns].astype(np.float32)
    index = np.arange(len(place))

    def window(array: Map, first: int, depth: int, breadth: int) -> Map:
        across = best[:, None] + first + np.arange(depth)
        return np.asarray(array[index[:, None], across][:, :, BREADTH - breadth : BREADTH + breadth + 1])

    prefer_back = _votes(cost_front - cost_back)
    jump = profile[:, SPAN - 1] - profile[:, SPAN + 2]

    def mean(array: Map, inside: bool, depth: int = WINDOW, breadth: int = BREADTH) -> Map:
        return np.asarray(window(array, 1 - depth if inside else 1, depth, breadth).mean((1, 2)))

    keep = np.isfinite(place) & (mean(known, True) >= MIN_KNOWN)
    strength = contrast[index, best]
    features = np.stack(
        [
            strength / (strength + 30),
            np.minimum(lead, 5) / 5,
            np.abs(np.nan_to_num(place) + 0.7) / REACH,
            np.log(np.maximum(jump, 1)) / 3,
            np.clip(jump / np.maximum(profile[:, SPAN - 1], 1), 0, 1),
            -mean(prefer_back, True),
            mean(prefer_back, False),
            -mean(prefer_back, True, 3, 2),
            mean(prefer_back, False, 3, 2),
            mean(np.minimum(cost_front, 20), True) / 20,
            mean(np.minimum(cost_back, 20), False) / 20,
            mean(known, True),
            mean(known, False),
        ],
        axis=1,
    )
    uv = np.stack([u + du * place, v + dv * place], axis=1)
    return Silhouettes(uv[keep], front[index, best][keep].astype(np.float64), features[keep].astype(np.float64))


def confidence(silhouettes: Silhouettes, side: Side, size: tuple[int, int]) -> Float:
    """Return the probability (N,) that silhouettes of an image (H, W) are true and accurate within 1 px.

    Each point is classified by its features, then again together with the points that continue its line over 3 px to
    both sides.
    """
    own, joint = (np.array(c) for c in JUDGEMENT[side])
    first = silhouettes.features @ own[:-1] + own[-1]
    both = np.stack([first, support(silhouettes.uv, _logistic(first), side, size)], axis=1)
    return _logistic(both @ joint[:-1] + joint[-1])


def support(uv: Float, belief: Float, side: Side, size: tuple[int, int]) -> Float:
    """Return the mean probability (N,) of the points beside each of uv (N, 2), over 3 px along the edge to both sides.

    The line may deviate by up to 2 px to either side; a missing neighbour counts 0.
    """
    import cv2

    height, width = size
    u, v = np.clip(uv.round(), 0, (width - 1, height - 1)).astype(np.int64).T
    drawn = np.zeros(size, np.float32)
    np.maximum.at(drawn, (v, u), belief.astype(np.float32))
    across, along = ((1, 5), (1, 7)) if side.background[0] else ((5, 1), (7, 1))
    drawn = cv2.dilate(drawn, np.ones(across, np.uint8))
    total = cv2.boxFilter(drawn, -1, along, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray((total[v, u] - drawn[v, u]) / 6, dtype=np.float64)


def line_lengths(uv: Float, size: tuple[int, int]) -> Int:
    """Return the number (N,) of points in the line of each point (N, 2) of one direction in an image (H, W).

    Points belong to one line if at most one pixel separates them.
    """
    import cv2

    u, v = np.clip(uv.round(), 0, (size[1] - 1, size[0] - 1)).astype(np.int64).T
    drawn = np.zeros(size, np.uint8)
    drawn[v, u] = 1
    number = cv2.connectedComponents(cv2.dilate(drawn, np.ones((2, 2), np.uint8)), connectivity=8)[1][v, u]
    return np.asarray(np.bincount(number, minlength=1)[number])


def _logistic(value: Float) -> Float:
    return np.asarray(1 / (1 + np.exp(-np.clip(value, -30, 30))))


def votes_against(
    view: PairView, silhouettes: Silhouettes, towards: tuple[int, int], plane: tuple[float, float, float]
) -> Float:
    """Return the majority (N,) of pixels inside silhouettes that prefer the foreground's disparity to that of a plane.

    Between -1 and 1, in a window inside the edge with the background `towards` (du, dv); `plane` (a, b, c) has
    disparity a + b u + c v px at pixel (u, v).
    """
    # The row at an edge mixes both colours and would fit any disparity through the edge itself. The same holds for
    # columns, but poles are too thin to omit a pixel there.
    u, v = silhouettes.pixels(towards, inside_px=1.5 if towards[1] else 0.5).T
    rows, columns = _window(view, v, u, towards, np.arange(1 - WINDOW, 1))
    own = view.own[rows, columns]
    on_plane = np.maximum(plane[0] + plane[1] * columns + plane[2] * rows, 0)
    cost_plane = _cost(view, own, rows, (columns - on_plane).astype(np.float32))
    cost_front = _cost(view, own, rows, (columns - silhouettes.disparity[:, None, None]).astype(np.float32))
    return np.asarray(_votes(cost_plane - cost_front).mean((1, 2)), dtype=np.float64)


def _window(view: PairView, v: Int, u: Int, towards: tuple[int, int], k: Int) -> tuple[Int, Int]:
    """Return rows and columns (N, K, T) at offsets k along `towards` from pixels (v, u) and BREADTH to both sides."""
    (height, width), (du, dv), t = view.disparity.shape, towards, np.arange(-BREADTH, BREADTH + 1)
    columns = np.clip(u[:, None, None] + du * k[:, None] + abs(dv) * t, 0, width - 1)
    rows = np.clip(v[:, None, None] + dv * k[:, None] + abs(du) * t, 0, height - 1)
    return rows, columns


def _votes(difference: Map) -> Map:
    """Return the sign of cost differences, 0 where they are within the noise of one grey level."""
    return np.asarray(np.sign(difference) * (np.abs(difference) > 1))


def snap(own: Map, uv: Float, reach_px: float) -> Float:
    """Return the columns (N,) of the strongest change of colour along the row within `reach_px` of uv (N, 2) px.

    Distance counts against strength; NaN where the colour does not change.
    """
    height, width = own.shape[:2]
    reach = int(np.ceil(reach_px)) + 1
    k = np.arange(-reach - 1, reach + 2)
    u, v = np.floor(uv[:, 0]).astype(np.int64), uv[:, 1].round().astype(np.int64)
    columns = np.clip(u[:, None, None] + k[:, None], 0, width - 1)
    rows = np.clip(v[:, None, None] + np.arange(-1, 2), 0, height - 1)
    change = np.diff(own[rows, columns, :3].mean(2), axis=1)
    peak, place, strength = _peaks(np.sqrt((change**2).sum(2)))
    place = place + k[1:-2] + 0.5
    far = np.abs(u[:, None] + place - uv[:, :1])
    score = np.where(peak & (far <= reach_px), strength / (1 + far**2), -np.inf)
    best = score.argmax(1)
    index = np.arange(len(best))
    return np.where(np.isfinite(score[index, best]), u + place[index, best], np.nan)


def _extended(profile: Map, middle: int, k: Int) -> Map:
    """Return the disparity (N, K) at offsets k of a surface sampled at five pixels (N, 5) around offset `middle`."""
    slope = (profile[:, -1] - profile[:, 0]) / 4
    slope = np.where(np.abs(slope) < 0.5, slope, 0)
    return (np.median(profile, axis=1)[:, None] + slope[:, None] * (k - middle)).astype(np.float32)


def _cost(view: PairView, own: Map, rows: Int, columns: Map) -> Map:
    """Return the cost of pixels in the other image at (rows, columns), in grey levels, best within +-0.5 px."""
    cost = np.full(rows.shape, np.inf, np.float32)
    for shift in (-0.5, 0.0, 0.5):
        difference = np.abs(own - _sampled(view.other, rows, columns + shift))
        colour = (difference[..., 0] + difference[..., 1] + difference[..., 2]) / 3
        np.minimum(cost, np.minimum(colour, 25) + np.minimum(difference[..., 3], 25), out=cost)
    return cost


def _sampled(image: Map, rows: Int, columns: Map) -> Map:
    """Return image (H, W, C) at integer rows and fractional columns of any shape, linear, the border repeated."""
    import cv2

    size = rows.size
    strip = (-(-max(size, 1) // 2048), 2048)
    u, v = np.zeros(strip, np.float32), np.zeros(strip, np.float32)
    u.reshape(-1)[:size], v.reshape(-1)[:size] = columns.reshape(-1), rows.reshape(-1)
    sampled = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled.reshape(-1, image.shape[2])[:size].reshape(*rows.shape, image.shape[2]))


def _peaks(strength: Map) -> tuple[NDArray[np.bool_], Map, Map]:
    """Return, for all but the first and last of strengths (N, K): peak mask, sub-pixel offset, peak strength."""
    before, here, after = strength[:, :-2], strength[:, 1:-1], strength[:, 2:]
    peak = (here >= before) & (here > after) & (here > 3)
    offset = 0.5 * (before - after) / np.minimum(before - 2 * here + after, -1e-3)
    return peak, np.clip(offset, -0.5, 0.5), here


def _split(preference: Map, contrast: Map, k: Int, prior: tuple[float, float, float]) -> tuple[Map, Int, Map]:
    """Return the index (N,) of the last foreground pixel, and the lead over the second best place.

    `preference` (N, K, T) is the cost of the foreground's disparity minus that of the background's, `contrast` (N, K -
    1) the colour change to the next pixel. Among all peaks of the contrast within REACH, the one is selected whose
    pixels inside prefer the foreground and outside the background, weighted by `prior` as in PRIOR. NaN where there is
    no peak.
    """
    outwards, pull, nearness = prior
    vote = np.clip(preference, -10, 10).mean(2)
    near = np.arange(SPAN - REACH, SPAN + REACH + 1)
    peak, offset, strength = _peaks(contrast[:, near[0] - 1 : near[-1] + 2])
    score = np.cumsum(vote, axis=1)[:, near] / 20 - pull * strength / (strength + 25)
    score += outwards * k[near] + nearness * (k[near] + 1) ** 2
    order = np.sort(np.where(peak, score, 50), axis=1)
    best = np.where(peak, score, np.inf).argmin(1)
    index = np.arange(len(best))
    place = np.where(peak.any(1), k[near][best] + 0.5 + offset[index, best], np.nan)
    return place, near[best], order[:, 1] - order[:, 0]
