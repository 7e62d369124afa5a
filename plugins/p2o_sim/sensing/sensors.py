"""Named LiDAR models. Beam tables and noise: manuals, drivers, KITTI's files (METHODS-baselines.md, section 10.1)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from p2o_sim.sensing.lidar import Lidar, Rosette


def _even(high: float, low: float, count: int) -> tuple[float, ...]:
    return tuple(float(v) for v in np.linspace(high, low, count))


# fmt: off
_KITTI_ELEVATION_DEG = (
    1.937, 1.574, 1.305, 0.872, 0.579, 0.181, -0.089, -0.452, -0.803, -1.201, -1.494, -1.833, -2.208, -2.547, -2.874,
    -3.236, -3.539, -3.936, -4.216, -4.588, -4.914, -5.251, -5.611, -5.958, -6.329, -6.676, -6.999, -7.287, -7.679,
    -8.058, -8.310, -8.711, -9.026, -9.574, -10.062, -10.471, -10.957, -11.599, -12.115, -12.562, -13.041, -13.485,
    -14.048, -14.598, -15.189, -15.657, -16.177, -16.554, -17.187, -17.730, -18.323, -18.797, -19.320, -19.736,
    -20.223, -20.788, -21.318, -21.936, -22.438, -22.856, -23.322, -23.970, -24.506, -24.999,
)
_PANDAR_ELEVATION_DEG = (
    14.882, 11.032, 8.059, 5.057, 3.040, 2.028, 1.860, 1.688, 1.522, 1.351, 1.184, 1.013, 0.846, 0.675, 0.508, 0.337,
    0.169, 0.0, -0.169, -0.337, -0.508, -0.675, -0.845, -1.013, -1.184, -1.351, -1.522, -1.688, -1.860, -2.028, -2.198,
    -2.365, -2.536, -2.700, -2.873, -3.040, -3.210, -3.375, -3.548, -3.712, -3.884, -4.050, -4.221, -4.385, -4.558,
    -4.720, -4.892, -5.057, -5.229, -5.391, -5.565, -5.726, -5.898, -6.061, -7.063, -8.059, -9.060, -9.885, -11.032,
    -12.006, -12.974, -13.930, -18.889, -24.897,
)
# fmt: on
_PANDAR_CYCLE_DEG = (1.042, 3.125, 5.208, -5.208, -3.125, -1.042)
_PANDAR_AZIMUTH_DEG = (-1.042,) * 6 + tuple(_PANDAR_CYCLE_DEG[i % 6] for i in range(47)) + (-1.042,) * 11

_HDL_64E = Lidar(
    name="HDL-64E of KITTI", elevation_deg=_KITTI_ELEVATION_DEG, columns=2083, max_range_m=80.0,
    height_m=_even(0.209, 0.198, 32) + _even(0.126, 0.116, 32),
)  # fmt: skip
"""KITTI's Velodyne, fitted to its raw sweeps: z = d tan(elevation) + height for every ring, to 0.5 mm.

Its range is limited to 80 m, as in KITTI's files.
"""

LIDARS: Mapping[str, Lidar | Rosette] = {
    "hdl-64e": _HDL_64E,
    "hdl-32e": Lidar(
        name="HDL-32E", elevation_deg=_even(10.67, -30.67, 32), columns=2170, max_range_m=100.0, divergence_mrad=2.8,
    ),
    "vlp-16": Lidar(
        name="VLP-16", elevation_deg=_even(15.0, -15.0, 16), columns=1809, max_range_m=100.0, range_noise_m=0.03,
        divergence_mrad=3.0,
    ),
    "os1-64": Lidar(
        name="OS1-64 gen 1", elevation_deg=_even(17.042, -16.300, 64), azimuth_deg=(3.07, 0.92, -1.24, -3.39) * 16,
        columns=1024, range_noise_m=0.015, divergence_mrad=3.1,
    ),
    "os1-128": Lidar(
        name="OS1-128", elevation_deg=_even(22.5, -22.5, 128), columns=1024, range_noise_m=0.015, divergence_mrad=3.1,
    ),
    "pandar64": Lidar(
        name="Pandar64", elevation_deg=_PANDAR_ELEVATION_DEG, azimuth_deg=_PANDAR_AZIMUTH_DEG, columns=1800,
        min_range_m=0.3, max_range_m=200.0, dark_range_m=200.0, divergence_mrad=2.0,
    ),
    "mid-40": Rosette(
        name="Livox Mid-40", deflection_deg=(9.6, 9.6), rpm=(7294.0, -4664.0), points_per_s=100_000.0,
        max_range_m=260.0, dark_range_m=90.0, divergence_mrad=4.9,
    ),
    "avia": Rosette(
        name="Livox Avia", deflection_deg=(17.6, 17.6), rpm=(7294.0, -4664.0), points_per_s=240_000.0,
        lines_deg=_even(3.4, -3.4, 6), min_range_m=1.0, max_range_m=450.0, dark_range_m=190.0, divergence_mrad=4.9,
    ),
    "mid-360": Rosette(
        name="Livox Mid-360", deflection_deg=(14.0, 14.0), rpm=(1207.0, -7411.0), points_per_s=200_000.0,
        lines_deg=_even(24.0, 21.0, 4), spin_rpm=613.0, min_range_m=0.1, max_range_m=70.0, dark_range_m=40.0,
        divergence_mrad=4.9,
    ),
}  # fmt: skip
"""All LiDAR models by name.

Avia and Mid-360 have fields of view, rates and ranges of their data sheets; the speeds of their optics are not
published, and are chosen such that the pattern does not repeat within seconds.
"""
