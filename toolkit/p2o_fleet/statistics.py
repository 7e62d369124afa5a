"""Sequential tests of the errors of an extrinsic: e-processes per axis, false discovery rate, onset and size.

An e-process is a non-negative statistic whose expectation is at most 1 at every stopping time if the hypothesis holds,
so it may be evaluated after every check (Ramdas, Grünwald, Vovk, Shafer, Statistical Science 2023). Errors are
standardised by their predicted deviations and clipped. Arrays have one row per check, in order of time.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from p2o.arrays import Bool, Float
from p2o.confidence.audit import AXES

CLIP = 4.0
"""Limit of a standardised error: the edges of a single check may be wrong matches."""
SHIFTS = (0.5, 1.0, 2.0)
"""Alternatives in standard deviations of a check: each is one bet, and the e-process is their mean."""
TYPE_SHIFTS = (0.5, 1.0, 2.0, 5.0)
"""Alternatives of the error of a type beyond the tolerance, in tolerances."""
_SINCE_FIRST = 0.25
"""Prior probability of an error that exists since the first check; the rest is for an onset at a later one."""
_NEIGHBOURS = 3
_MIN_DEVIATIONS = 30


def onset_prior(count: int) -> Float:
    """Return the prior probability (count,) that an error begins at each check; its sum stays below 1 for any count.

    Later checks get 1 / (k log^2 k), so that old histories detect a new error almost as fast as young ones.
    """
    k = np.arange(1.0, count)
    rest = 1.0 / ((k + 1) * np.log(k + 1) ** 2)
    # The sum of 1 / (k log^2 k) from k = 2 on is 2.1098.
    return np.concatenate([[_SINCE_FIRST], (1 - _SINCE_FIRST) * rest / 2.11])[:count]


def mixture_over_onsets(log_ratios: Float) -> Float:
    """Return the log e-process (T, B) of bets with log likelihood ratios (T, B), mixed over the onset of the error.

    E_t = sum_k pi_k prod_(k <= i <= t) L_i + (1 - sum_(k <= t) pi_k): the bets begin at check k with probability pi_k.
    """
    prior = onset_prior(len(log_ratios))
    total = np.cumsum(log_ratios, axis=0)
    before = total - log_ratios
    started = total + np.logaddexp.accumulate(np.log(prior)[:, None] - before)
    waiting = np.log1p(-np.minimum(np.cumsum(prior), 1 - 1e-12))
    return np.logaddexp(started, waiting[:, None])


def bets(standard: Float, tolerance: Float) -> Float:
    """Return log likelihood ratios (T, 6, 2, S) of errors above the tolerance, by axis, sign and alternative.

    `standard` (T, 6) are standardised errors, `tolerance` (T, 6) the largest error that counts as none, in the same
    unit. For each true error within the tolerance, the expectation of the ratio is at most 1.
    """
    shifts = np.array(SHIFTS)
    signed = np.clip(np.stack([standard - tolerance, -standard - tolerance], axis=-1), -CLIP, CLIP)
    return np.asarray(signed[..., None] * shifts - shifts**2 / 2)


def conditional(error: Float, covariance: Float) -> tuple[Float, Float]:
    """Return estimates (T, 6) of the error of each axis if all others are correct, and their deviations (T, 6)."""
    information = np.linalg.inv(covariance)
    own = np.einsum("tii->ti", information)
    return np.einsum("tij,tj->ti", information, error) / own, 1 / np.sqrt(own)


def beside_previous(values: Float, sigma: Float) -> Float:
    """Return the difference (T, A) of each value from the weighted mean of all previous ones, standardised.

    With independent errors of known deviations `sigma` (T, A) about an unknown constant mean, the results are
    independent with mean 0 and deviation 1 (Hawkins, The Statistician 1987). The first row is 0: it carries no
    information about a change.
    """
    weight = 1 / sigma**2
    total = np.cumsum(weight, axis=0)
    mean = np.cumsum(weight * values, axis=0) / total
    out = np.zeros_like(values)
    out[1:] = (values[1:] - mean[:-1]) / np.sqrt(sigma[1:] ** 2 + 1 / total[:-1])
    return out


def e_process(error: Float, covariance: Float, tolerance: Float) -> Float:
    """Return the log e-process (T, 6) of each axis; the mean over the axes is one of the whole extrinsic.

    `tolerance` (6,) is the largest constant error, in deg and m, that counts as correct: it covers the systematic
    errors of the edges and of the extrinsic itself. Three statistics are averaged: the error itself beyond the
    tolerance, its change against the mean of all previous checks, and the change of each axis under the assumption that
    the others did not change.
    """
    if not len(error):
        return np.zeros((0, len(AXES)))
    sigma = np.sqrt(np.einsum("tii->ti", covariance))
    none = np.zeros_like(error)
    alone, alone_sigma = conditional(error, covariance)
    parts = [
        bets(error / sigma, tolerance / sigma),
        bets(beside_previous(error, sigma), none),
        bets(beside_previous(alone, alone_sigma), none),
    ]
    # The first check cannot show a change: without a bet, its factor is 1.
    for part in parts[1:]:
        part[0] = 0.0
    logs = [mixture_over_onsets(part.reshape(len(error), -1)).reshape(part.shape) for part in parts]
    return log_mean(np.stack(logs), axes=(0, 3, 4))


def log_mean(logs: Float, axes: tuple[int, ...]) -> Float:
    """Return the logarithm of the mean of exp(logs) over axes."""
    highest = logs.max(axis=axes, keepdims=True)
    mean = np.mean(np.exp(logs - highest), axis=axes)
    return np.asarray(np.log(mean) + highest.squeeze(axes))


def discoveries(log_e: Float, rate: float) -> Bool:
    """Return which hypotheses (N,) are rejected at a false discovery rate, by the e-BH procedure.

    The rate holds for any dependence between the e-values (Wang and Ramdas, J. R. Stat. Soc. B 2022).
    """
    count = len(log_e)
    if not count:
        return np.zeros(0, bool)
    order = np.argsort(-log_e, kind="stable")
    enough = log_e[order] >= np.log(count / rate) - np.log(np.arange(1, count + 1))
    out = np.zeros(count, bool)
    if enough.any():
        out[order[: int(np.flatnonzero(enough)[-1]) + 1]] = True
    return out


@dataclass(frozen=True)
class Onset:
    """When an error of one axis began: the most likely check, and the first and last one of the 95 % interval."""

    index: int
    first: int
    last: int


def onset(values: Float, sigma: Float) -> Onset:
    """Return the onset of a change of the mean of values (T,) by the profile likelihood.

    An onset at 0 states that one mean explains all values. The interval contains the onsets whose log likelihood is
    within 1.92 of the highest, half the 95 % quantile of chi-square.
    """
    weight = 1 / sigma**2
    clipped = robust(values, sigma)
    total, first = np.cumsum(weight), np.cumsum(weight * clipped)
    rest, last = total[-1] - total[:-1], first[-1] - first[:-1]
    gain = np.concatenate([[first[-1] ** 2 / total[-1]], first[:-1] ** 2 / total[:-1] + last**2 / rest]) / 2
    # Of T possible changes, the best one of pure noise gains about this much.
    gain[0] += 1.92 + np.log(len(values))
    near = np.flatnonzero(gain >= gain.max() - 1.92)
    return Onset(int(gain.argmax()), int(near[0]), int(near[-1]))


def robust(values: Float, sigma: Float) -> Float:
    """Return values (T,) with single outliers pulled to within `CLIP` deviations of the running median of seven."""
    half = 3
    padded = np.pad(values, half, mode="reflect" if len(values) > half else "edge")
    median = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    return np.asarray(np.clip(values, median - CLIP * sigma, median + CLIP * sigma))


@dataclass(frozen=True, eq=False)
class MeanError:
    """The weighted mean (6,) of errors, and its covariance (6, 6)."""

    error: Float
    covariance: Float

    @property
    def sigma(self) -> Float:
        """Return the standard deviations (6,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def mean_error(error: Float, covariance: Float) -> MeanError:
    """Return the mean of errors (T, 6) weighted by the inverse of their covariances (T, 6, 6).

    Checks whose error differs from the median by more than `CLIP` deviations on an axis get less weight.
    """
    excess = np.abs(error - np.median(error, axis=0)) / np.sqrt(np.einsum("tii->ti", covariance))
    wider = np.maximum(1.0, excess.max(axis=1) / CLIP) ** 2
    information = np.linalg.inv(covariance) / wider[:, None, None]
    total = np.linalg.inv(information.sum(axis=0))
    return MeanError(total @ np.einsum("tij,tj->i", information, error), total)


def noise_scale(deviations: Sequence[Float], most: float = 4.0) -> tuple[float, ...]:
    """Return the factor (6,) of predicted deviations by `local_deviations` (n, 6) of several vehicles.

    It is the smallest one, at least 1, with which every bet has an expectation of at most 1, so that tails that are
    heavier than normal cause no false alarms. Fewer than 30 checks give 1.
    """
    pooled = np.concatenate([np.zeros((0, len(AXES))), *deviations])
    if len(pooled) < _MIN_DEVIATIONS:
        return (1.0,) * len(AXES)
    return tuple(_fair_scale(column, most) for column in pooled.T)


def _fair_scale(values: Float, most: float) -> float:
    """Return the smallest factor from 1 to `most` by which values (n,) have to be divided for fair bets."""
    shifts = np.array(SHIFTS)[:, None]

    def excess(scale: float) -> float:
        clipped = np.clip(values / scale, -CLIP, CLIP)
        return max(float(np.exp(shifts * part - shifts**2 / 2).mean(axis=1).max()) for part in (clipped, -clipped)) - 1

    if excess(1.0) <= 0:
        return 1.0
    low, high = 1.0, most
    for _ in range(30):
        middle = (low + high) / 2
        low, high = (middle, high) if excess(middle) > 0 else (low, middle)
    return high


def local_deviations(error: Float, covariance: Float) -> Float:
    """Return the standardised deviations (n, 6) of errors (T, 6) from the median of three checks before and after each.

    A slip changes few of them. The median of six normal values has a variance of about 0.26, which is accounted for.
    Fewer than seven checks give none.
    """
    if len(error) < 2 * _NEIGHBOURS + 1:
        return np.zeros((0, len(AXES)))
    windows = np.lib.stride_tricks.sliding_window_view(error, 2 * _NEIGHBOURS + 1, axis=0)
    others = np.delete(windows, _NEIGHBOURS, axis=-1)
    inner = slice(_NEIGHBOURS, len(error) - _NEIGHBOURS)
    sigma = np.sqrt(np.einsum("tii->ti", covariance)[inner] * 1.26)
    return np.asarray((error[inner] - np.median(others, axis=-1)) / sigma)


@dataclass(frozen=True, eq=False)
class Systematic:
    """The mean error (6,) of the vehicles of one type, its deviations (6,), and the log e-value (6,) of an error."""

    error: Float
    sigma: Float
    log_e: Float


def systematic(means: Float, sigmas: Float, tolerance: Float) -> Systematic:
    """Test the mean error of a type of vehicles, whose vehicles (V) have mean errors (V, 6) with deviations (V, 6).

    Vehicles differ: their errors are normal about the mean of the type with an unknown spread, at least `tolerance`
    (6,). The log e-value (6,) is that of a mean beyond the tolerance: for a known spread, likelihood ratios of all
    vehicles multiply to an e-process, however many checks each vehicle has.
    """
    spread = _between(means, sigmas, tolerance)
    wide = np.sqrt(sigmas**2 + spread**2)
    weight = 1 / wide**2
    centre = np.median(means, axis=0)
    clipped = np.clip(means, centre - CLIP * wide, centre + CLIP * wide)  # a vehicle that slipped is no evidence
    error = (weight * clipped).sum(axis=0) / weight.sum(axis=0)
    ratios = []
    for sign in (1.0, -1.0):
        for factor in TYPE_SHIFTS:
            shift = factor * tolerance
            ratios.append((shift * (sign * clipped - tolerance) - shift**2 / 2) / wide**2)
    log_e = log_mean(np.sum(ratios, axis=1), axes=(0,))
    return Systematic(error, 1 / np.sqrt(weight.sum(axis=0)), log_e)


def _between(means: Float, sigmas: Float, least: Float) -> Float:
    """Return the robust spread (6,) between vehicles beyond their own uncertainty."""
    centre = np.median(means, axis=0)
    mad = np.median(np.abs(means - centre), axis=0) / 0.6745
    return np.sqrt(np.maximum(mad**2 - np.median(sigmas, axis=0) ** 2, least**2))


@dataclass(frozen=True, eq=False)
class Trend:
    """Slopes (6, C) of the errors on C covariates, pooled over vehicles, and their deviations (6, C)."""

    slope: Float
    sigma: Float

    @property
    def significant(self) -> Float:
        """Return the slopes, 0 for those within four deviations."""
        return np.where(np.abs(self.slope) > 4 * self.sigma, self.slope, 0.0)


def trend(vehicles: Sequence[tuple[Float, Float, Float]], least: int = 50) -> Trend | None:
    """Return the common slopes on covariates of the errors of vehicles; None for fewer than `least` checks.

    Each vehicle has errors (T, 6), their deviations (T, 6) and covariates (T, C), and its own mean, so that differences
    between vehicles do not count. Residuals beyond 3 deviations count as 3 (Huber), so that slips of few vehicles do
    not change the slopes.
    """
    if sum(len(error) for error, *_ in vehicles) < least:
        return None
    count = vehicles[0][2].shape[1]
    slope, deviation = np.zeros((len(AXES), count)), np.full((len(AXES), count), np.inf)
    for axis in range(len(AXES)):
        weights = [1 / sigma[:, axis] ** 2 for _, sigma, _ in vehicles]
        means = [np.average(values, axis=0, weights=own) for (*_, values), own in zip(vehicles, weights, strict=True)]
        rows = np.concatenate([values - mean for (*_, values), mean in zip(vehicles, means, strict=True)])
        if np.linalg.matrix_rank(rows) < count:
            return None
        weight = robust_weight = np.concatenate(weights)
        centred = np.concatenate([error[:, axis] - np.median(error[:, axis]) for error, *_ in vehicles])
        for _ in range(10):
            normal = (rows * robust_weight[:, None]).T @ rows
            slope[axis] = np.linalg.solve(normal, rows.T @ (robust_weight * centred))
            residual = np.abs(centred - rows @ slope[axis]) * np.sqrt(weight)
            robust_weight = weight * np.minimum(1.0, 3.0 / np.maximum(residual, 1e-9))
        excess = max(1.0, float(np.average(residual**2, weights=robust_weight / weight)))
        deviation[axis] = np.sqrt(excess * np.diag(np.linalg.inv(normal)))
    return Trend(slope, deviation)
