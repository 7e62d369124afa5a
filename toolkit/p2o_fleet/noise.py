"""Noise of checks by type and sensors, estimated from the fleet itself, and trends with temperature and time of day."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from p2o.arrays import Float
from p2o.confidence.audit import AXES
from p2o.frames.selection import spread

from p2o_fleet.checks import Checks
from p2o_fleet.segments import Pair, segments_of
from p2o_fleet.statistics import Trend, local_deviations, noise_scale, trend
from p2o_fleet.store import Store

COVARIATES = ("degree Celsius", "sine of the time of day", "cosine of the time of day")
_SAMPLED = 120
"""Number of checks of an extrinsic from which noise and trends are estimated."""
_MIN_VEHICLES = 5
"""Minimum number of vehicles for a trend: with fewer ones, a drift of one vehicle looks like a trend."""
_DAY_S = 86400.0


def _no_trend() -> Trend:
    return Trend(np.zeros((len(AXES), len(COVARIATES))), np.full((len(AXES), len(COVARIATES)), np.inf))


@dataclass(frozen=True, eq=False)
class PairNoise:
    """How errors of checks of a type and pair of sensors vary at a constant extrinsic.

    `scale` (6,) multiplies their predicted deviations; `trend` is about the `reference` (3,) of the covariates.
    """

    scale: tuple[float, ...] = (1.0,) * len(AXES)
    trend: Trend = field(default_factory=_no_trend)
    reference: Float = field(default_factory=lambda: np.zeros(len(COVARIATES)))

    def covariance_of(self, checks: Checks) -> Float:
        """Return the covariances (T, 6, 6) of checks with this noise."""
        return np.asarray(checks.covariance * np.outer(self.scale, self.scale))

    def without_trend(self, checks: Checks) -> Float:
        """Return the errors (T, 6) of checks without the significant trends; unknown covariates change nothing."""
        covariates = np.nan_to_num(covariates_of(checks) - self.reference)
        return np.asarray(checks.error - covariates @ self.trend.significant.T)

    def trend_texts(self) -> Iterator[str]:
        """Yield the significant trends as texts."""
        slopes = self.trend.significant
        for axis, number in np.argwhere(slopes):
            size, sigma = slopes[axis, number], self.trend.sigma[axis, number]
            yield f"{AXES[axis][0]} {size:+.2g} +- {sigma:.2g} {AXES[axis][1]} per {COVARIATES[number]}"


Samples = dict[Pair, list[Checks]]
"""Sampled checks of extrinsics by type and pair of sensors, without texts."""


def sampled(store: Store, vehicles: Sequence[str], now: float) -> Samples:
    """Return some checks of each extrinsic of these vehicles, by type and pair of sensors."""
    samples: Samples = {}
    for checks in store.checks(vehicles):
        for extrinsic, every in segments_of(checks, now):
            own = every.take(np.array(spread(np.flatnonzero(every.usable).tolist(), _SAMPLED), np.int64))
            if len(own) > 1:
                samples.setdefault(extrinsic.pair, []).append(replace(own, texts={}, damaged=()))
    return samples


def estimate_noise(samples: Iterable[Samples]) -> dict[Pair, PairNoise]:
    """Estimate noise and trends of each type and pair of sensors from sampled checks of all vehicles."""
    every: Samples = {}
    for part in samples:
        for pair, own in part.items():
            every.setdefault(pair, []).extend(own)
    return {pair: _pair_noise(own) for pair, own in every.items()}


def covariates_of(checks: Checks) -> Float:
    """Return temperature in degrees Celsius, sine and cosine of the time of day (UTC), as columns (T, 3)."""
    angle = 2 * np.pi * (checks.time % _DAY_S) / _DAY_S
    return np.column_stack([checks.temperature_c, np.sin(angle), np.cos(angle)])


def _pair_noise(samples: Sequence[Checks]) -> PairNoise:
    scale = noise_scale([local_deviations(one.error, one.covariance) for one in samples])
    covariates = list(map(covariates_of, samples))
    every = np.concatenate(covariates)
    known = np.isfinite(every).mean(axis=0) > 0.5
    columns = [n for n in np.flatnonzero(known) if np.nanmax(every[:, n]) - np.nanmin(every[:, n]) > 0.2]
    parts = []
    for one, values in zip(samples, covariates, strict=True):
        rows = np.isfinite(values[:, columns]).all(axis=1)
        if rows.sum() > 1:
            sigma = np.sqrt(np.einsum("tii->ti", one.covariance[rows])) * np.array(scale)
            parts.append((one.error[rows], sigma, values[rows][:, columns]))
    slopes = trend(parts) if columns and len(parts) >= _MIN_VEHICLES else None
    if slopes is None:
        return PairNoise(scale)
    full = _no_trend()
    full.slope[:, columns], full.sigma[:, columns] = slopes.slope, slopes.sigma
    reference = np.zeros(len(COVARIATES))
    reference[columns] = np.nanmedian(every[:, columns], axis=0)
    return PairNoise(scale, full, reference)
