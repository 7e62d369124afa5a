"""Figures that compare methods without ground truth, with bootstrap intervals over groups of frames, and a ranking.

Arrays: M methods, G disjoint groups of frames, S initial guesses, H groups on which a pose is evaluated (H = G), B
bootstrap samples of the groups after the sample itself. All methods share the bootstrap samples (paired bootstrap;
Efron and Tibshirani 1993). Tangents (..., 6) are rotation vectors in degrees and translations in metres.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from p2o.arrays import Bool, Float, Int
from p2o.geometry import se3

from p2o_study.statistics import MIN_FRAMES, SHARE, WRONG, Interval, draws_of

MIN_GROUPS = MIN_FRAMES
"""With fewer groups there are too few distinct bootstrap samples."""
DEPTH_M = 10.0
"""Rotations and translations are combined as the displacement of a point at this depth, for ranks only."""
_FOLLOWS = 0.5
"""Share of the error of the initial guesses in the results from which a reader must know it."""
_ITERATIONS = 50
_EPS = 1e-9


@dataclass(frozen=True, eq=False)
class Samples:
    """What was computed of the methods `names`.

    `tangents` (M, G, S, 6) are the poses, `guesses` (M, G, S, 6) their initial guesses.
    `costs` (M, G, S, H) by judge are the costs of these poses on the frames of each group, and `shares` (M,) by judge
    whether the method uses features of the judge.
    """

    names: Sequence[str]
    families: Sequence[str]
    tangents: Float
    guesses: Float
    costs: Mapping[str, Float]
    shares: Mapping[str, Bool]


@dataclass(frozen=True, eq=False)
class Standing:
    """The figures of one method by name, with 95 % intervals, and its rank.

    `tier` 1 is the top group: methods that cannot be distinguished from the best at 95 %. `score` is the mean of the
    normalised ranks, 0 (best) to 1. `follows` is the share of the error of the initial guess that results keep.
    """

    name: str
    family: str
    tier: int
    score: float
    follows: float
    figures: Mapping[str, Interval]

    @property
    def scatter_m(self) -> float:
        """The repeatability as the displacement of a point at `DEPTH_M`."""
        return float(size_m(np.array([self.figures["repeatability_deg"].value, self.figures["repeatability_m"].value])))


def to_tangents(poses: Float, reference: Float) -> Float:
    """Return poses (..., 4, 4) as tangents (..., 6) at a reference (4, 4)."""
    from scipy.spatial.transform import Rotation

    rotation = (poses[..., :3, :3] @ reference[:3, :3].T).reshape(-1, 3, 3)
    vectors = Rotation.from_matrix(rotation).as_rotvec(degrees=True).reshape(*poses.shape[:-2], 3)
    return np.concatenate([vectors, poses[..., :3, 3] - reference[:3, 3]], axis=-1)


def reference_pose(poses: Float) -> Float:
    """Return the component-wise median of poses (N, 4, 4), with the nearest rotation, as the reference of tangents."""
    from scipy.spatial.transform import Rotation

    middle = np.median(poses, axis=0)
    return se3.make(Rotation.from_matrix(middle[:3, :3]).as_matrix(), middle[:3, 3])


def size_m(lengths: Float) -> Float:
    """Return the displacement (...,) in metres at `DEPTH_M` of rotations in deg and translations in m (..., 2)."""
    return np.hypot(np.radians(lengths[..., 0]) * DEPTH_M, lengths[..., 1])


def figures_of(samples: Samples) -> tuple[dict[str, Float], Float]:
    """Return the figures (1 + B, M) by name and the scores (1 + B, M); the first row is the sample itself.

    - repeatability: standard deviation of one calibration about the mean pose of its method, over groups and guesses;
    - guesses, groups: its parts, within the groups and between the means of the groups;
    - consensus: distance of the mean pose from the median of the other families;
    - edges, nid, ...: mean cost by a judge on the frames of the other groups.

    The score is the mean of the normalised ranks in repeatability, consensus and cost by judges.
    """
    count, groups, seeds, _ = samples.tangents.shape
    weights = np.concatenate([np.ones((1, groups)), draws_of(groups)])
    # A bootstrap sample underestimates the variance by the share of repeated groups.
    unbiased = np.where(np.arange(len(weights)) > 0, groups / (groups - 1), 1.0)[:, None, None]
    centres = samples.tangents.mean(axis=2)
    means = np.einsum("bg,mgk->bmk", weights, centres) / groups
    between = _squared_lengths(np.einsum("bg,mgk->bmk", weights, centres**2) / groups - means**2)
    between = np.maximum(between, 0) * unbiased * groups / (groups - 1)
    deviations = ((samples.tangents - centres[:, :, None]) ** 2).sum(axis=2) / max(seeds - 1, 1)
    within = _squared_lengths(np.einsum("bg,mgk->bmk", weights, deviations) / groups)
    total = np.sqrt(between + within * (1 - 1 / seeds))
    lengths = {"repeatability": total, "groups": np.sqrt(between)}
    if seeds > 1:
        lengths["guesses"] = np.sqrt(within)
    ranked = [_normalised_ranks(size_m(total))]
    if len(set(samples.families)) > 1:
        off = means - consensus(means, 1 / np.maximum(size_m(total), _EPS), samples.families)
        lengths["consensus"] = np.sqrt(_squared_lengths(off**2))
        ranked.append(_normalised_ranks(size_m(lengths["consensus"])))
    figures = {f"{name}_{unit}": v[..., i] for name, v in lengths.items() for i, unit in enumerate(("deg", "m"))}
    judged = {judge: _held_out(costs, weights) for judge, costs in samples.costs.items()}
    if judged and count > 1:
        ranked.append(_judged_ranks(judged, samples.shares))
    return figures | judged, np.mean(ranked, axis=0)


def _squared_lengths(squares: Float) -> Float:
    """Sum the squares (..., 6) of tangents to those of rotation and translation (..., 2)."""
    return np.asarray(squares.reshape(*squares.shape[:-1], 2, 3).sum(axis=-1))


def consensus(means: Float, trust: Float, families: Sequence[str]) -> Float:
    """Return for each method the median (B, M, 6) of the other families' mean poses (B, M, 6).

    A family is the mean of its methods weighted by `trust` (B, M), and counts with its highest trust. The median is the
    geometric one, of rotations and of translations.
    """
    members = {family: [i for i, other in enumerate(families) if other == family] for family in families}
    weights = np.repeat(trust[..., None], 6, axis=-1)
    places = {f: np.average(means[:, i], axis=1, weights=weights[:, i]) for f, i in members.items()}
    out = np.empty_like(means)
    for family, own in members.items():
        others = [other for other in members if other != family]
        points = np.stack([places[other] for other in others], axis=1)
        votes = np.stack([trust[:, members[other]].max(axis=1) for other in others], axis=1)
        halves = [geometric_median(points[..., part], votes) for part in (slice(3), slice(3, 6))]
        out[:, own] = np.concatenate(halves, axis=-1)[:, None]
    return out


def geometric_median(points: Float, weights: Float) -> Float:
    """Return the points (B, D) of least weighted sum of distances from points (B, N, D) with weights (B, N).

    Weiszfeld's iteration from the weighted mean: that of two points with equal weights is their middle.
    """
    pull = weights
    for _ in range(_ITERATIONS):
        middle = np.einsum("bn,bnd->bd", pull, points) / pull.sum(axis=1)[:, None]
        pull = weights / np.maximum(np.linalg.norm(points - middle[:, None], axis=-1), _EPS)
    return np.asarray(middle)


def _held_out(costs: Float, weights: Float) -> Float:
    """Return the mean cost (1 + B, M) of the poses of a group on the other groups, from costs (M, G, S, H).

    A group on which any cost is NaN (unknown) is left out for all methods.
    """
    known = np.asarray(np.isfinite(costs).all(axis=(0, 1, 2)))
    apart = np.where(known, costs.mean(axis=2), 0.0) * (1 - np.eye(len(known)))
    judging = weights * known
    total = np.einsum("bg,mgh,bh->bm", weights, apart, judging)
    pairs = weights.sum(axis=1) * judging.sum(axis=1) - (weights * judging).sum(axis=1)
    # A bootstrap sample of one repeated group has no pair of groups.
    return np.asarray(np.where(pairs[:, None] > 0, total / np.maximum(pairs, 1)[:, None], total[0] / pairs[0]))


def _judged_ranks(costs: Mapping[str, Float], shares: Mapping[str, Bool]) -> Float:
    """Return the mean normalised ranks (1 + B, M) by the judges that share no features with a method.

    Such a judge ranks the methods without shared features only; a method that no judge can rank so is ranked by all.
    """
    ranks = np.full((len(costs), *next(iter(costs.values())).shape), np.nan)
    for number, (judge, values) in enumerate(costs.items()):
        free = ~shares[judge]
        if free.sum() > 1:
            ranks[number][:, free] = _normalised_ranks(values[:, free])
    left = np.isnan(ranks).all(axis=(0, 1))
    for number, values in enumerate(costs.values()):
        ranks[number][:, left] = _normalised_ranks(values)[:, left]
    return np.asarray(np.nanmean(ranks, axis=0))


def _normalised_ranks(values: Float) -> Float:
    """Return ranks (B, M) from 0 (lowest value) to 1; equal values share their mean rank, a single one has 0."""
    from scipy.stats import rankdata

    # Distances of two families from each other are equal up to rounding.
    rounded = np.round(values, 9)
    return np.asarray((rankdata(rounded, axis=1) - 1) / max(values.shape[1] - 1, 1))


def tiers_of(scores: Float, scatter: Float) -> Int:
    """Return the tier (M,) of each method from scores and repeatability in metres, both (1 + B, M).

    A tier has the best of the remaining methods by score, and all that neither score nor repeatability distinguishes
    from it: they are not worse in at least 2.5 % of the samples. The score alone would not notice a large difference of
    scatter between methods of adjacent ranks.
    """
    remaining = list(np.lexsort((scatter[0], scores[0])))
    tiers = np.zeros(scores.shape[1], np.int64)
    while remaining:
        best = remaining[0]
        shares = [np.mean(v[1:] <= v[1:, [best]], axis=0) for v in (scores, np.round(scatter, 9))]
        as_good = [m for m in remaining if m == best or min(share[m] for share in shares) >= (1 - SHARE) / 2]
        tiers[as_good] = tiers.max() + 1
        remaining = [m for m in remaining if m not in as_good]
    return tiers


def standings(samples: Samples) -> list[Standing]:
    """Return the standing of each method, best first."""
    figures, scores = figures_of(samples)
    scatter = size_m(np.stack([figures["repeatability_deg"], figures["repeatability_m"]], axis=-1))
    tiers = tiers_of(scores, scatter)
    ends = {name: np.quantile(v[1:], [(1 - SHARE) / 2, (1 + SHARE) / 2], axis=0) for name, v in figures.items()}
    scale = np.repeat([np.radians(DEPTH_M), 1.0], 3)
    results, guesses = (
        scale * (t - t.mean(axis=(1, 2), keepdims=True)).reshape(len(t), -1, 6)
        for t in (samples.tangents, samples.guesses)
    )
    follows = (results * guesses).sum(axis=(1, 2)) / np.maximum((guesses**2).sum(axis=(1, 2)), _EPS)
    out = [
        Standing(
            name,
            samples.families[m],
            int(tiers[m]),
            float(scores[0, m]),
            float(follows[m]),
            {f: Interval(float(v[0, m]), *map(float, ends[f][:, m])) for f, v in figures.items()},
        )
        for m, name in enumerate(samples.names)
    ]
    return [out[m] for m in np.lexsort((scatter[0], scores[0], tiers))]


def distances(samples: Samples) -> list[tuple[str, str, float, float]]:
    """Return each pair of methods with the rotation in deg and the translation in m between their mean poses."""
    means = dict(zip(samples.names, samples.tangents.mean(axis=(1, 2)), strict=True))
    lengths = {
        pair: np.sqrt(_squared_lengths((means[pair[0]] - means[pair[1]]) ** 2)) for pair in combinations(means, 2)
    }
    return [(*pair, float(deg), float(m)) for pair, (deg, m) in lengths.items()]


def sentence(ranking: Sequence[Standing], apart: Sequence[tuple[str, str, float, float]], frames: int) -> str:
    """Return the result in one sentence."""
    top = [s.name for s in ranking if s.tier == 1]
    if len(ranking) == 1:
        deg, m = (ranking[0].figures[f"repeatability_{unit}"].value for unit in ("deg", "m"))
        return (
            f"On these {frames} frames {top[0]} repeats within {deg:.2g} deg / {_cm(m)}; a ranking needs two methods."
        )
    inside = [(deg, m) for a, b, deg, m in apart if {a, b} <= set(top)]
    if inside:
        deg, m = (max(values) for values in zip(*inside, strict=True))
        verb = "agree within" if deg <= WRONG.angle_deg and m <= WRONG.distance_m else "differ by up to"
        text = f"{_listed(top)} {verb} {deg:.2g} deg / {_cm(m)} and are indistinguishable at 95 %"
    else:
        text = f"{top[0]} ranks first, distinguishable at 95 % from all others"
    best = min(s.scatter_m for s in ranking if s.tier == 1)
    parts = [text]
    for other in (s for s in ranking if s.tier > 1):
        ratio = other.scatter_m / max(best, _EPS)
        if ratio >= 1.2:
            parts.append(f"{other.name} scatters {ratio:.2g} times more")
        elif "consensus_deg" in other.figures:
            deg, m = (other.figures[f"consensus_{unit}"].value for unit in ("deg", "m"))
            parts.append(f"{other.name} differs by {deg:.2g} deg / {_cm(m)} from the other families")
        else:
            parts.append(f"{other.name} ranks behind")
    return f"On these {frames} frames " + "; ".join(parts) + "."


def remarks(ranking: Sequence[Standing], shares: Mapping[str, Mapping[str, bool]]) -> list[str]:
    """Return what a reader must know of the ranking; `shares` are by judge and method."""
    lines = [
        f"{s.name} keeps {100 * s.follows:.0f} % of the error of its initial guess"
        for s in ranking
        if s.follows > _FOLLOWS
    ]
    for judge, by in shares.items():
        if own := [name for name, shared in by.items() if shared]:
            lines.append(
                f"held-out {judge}: the judge uses features of {_listed(own)} (marked *), which is in favour of such "
                "methods; other judges rank them if possible"
            )
    if len({s.family for s in ranking}) < 2:
        lines.append("all methods are of one family: an error that the family has in common is not observable")
    return lines


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def _cm(metres: float) -> str:
    return f"{100 * metres:.2g} cm" if metres < 1 else f"{100 * metres:.0f} cm"
