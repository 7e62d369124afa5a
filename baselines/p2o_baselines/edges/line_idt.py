"""Align line points with the inverse distance transform of image lines, `--matcher line-idt`.

With `--extractor line-idt/line-points --solver coordinate --init given`.

After Zhang et al., Line-Based Automatic Extrinsic Calibration of LiDAR and Camera, ICRA 2021: the row "line-based" of
Table II of P2O-Calib. The features of Levinson and Thrun restricted to lines, and a search with adaptive steps.

- Image: the largest grey-level difference of a pixel to its eight neighbours, within 3 px of the line segments of
  LSD; then the inverse distance transform with alpha = 1/3 and gamma = 0.98.
- Sweep: `line-points`; the original accumulates three sweeps, `--accumulate poses --set accumulate.past=2 --set
  accumulate.future=0`. One sweep is possible, with fewer points.
- Cost: minus the weighted mean of D(u_i) over the points; solver `coordinate`.
- Convergence: initial errors are at most 1.0 deg and 0.05 m. From eight of them, in joint calibration of ten synthetic
  streets, the final errors are 0.21 to 0.60 deg (median 0.34 deg, 5.4 cm), and with `grid729`, which is less affected
  by small local minima, 0.19 to 0.68 deg (0.23 deg, 4.4 cm). Single synthetic frames do not improve. The authors
  publish about 0.39 deg on KITTI.

Departures: the text of the paper was not at hand. LSD for the lines of images, all constants of `line-points` and the
steps of the search are ours; a point outside the image scores the mean of D, as in `idt`.

Its temporal successor (Wang et al., Temporal and Spatial Online Integrated Calibration for Camera and LiDAR, ITSC 2022)
first estimates the delay between the sensors from visual and LiDAR odometry and then refines as above: `line_time`.
"""

from __future__ import annotations

import numpy as np
import p2o

from p2o_baselines import examples
from p2o_baselines.edges.inverse_distance import MapOptions, edge_strength, map_features, map_matcher
from p2o_baselines.edges.lsd import segments

_MIN_LENGTH_PX = 15.0  # shortest line segment, in pixels
_WIDTH_PX = 3  # width of the strokes along segments outside which edges are dropped
_MAX_POINTS = 2000  # largest number of line points per frame


def extract(image: p2o.Image, options: MapOptions) -> p2o.ImageFeatures:
    """Return the inverse distance map of the lines of an image."""
    import cv2

    strength = edge_strength(image.grey)
    strokes = np.zeros(strength.shape, np.uint8)
    for first, last in np.rint(segments(image, _MIN_LENGTH_PX)).astype(int).tolist():
        cv2.line(strokes, first, last, 1, _WIDTH_PX)
    strength *= strokes
    return map_features(strength, options)


def build(options: p2o.Options) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`."""
    return map_matcher(_MAX_POINTS)


_CITE = "Zhang et al., Line-Based Automatic Extrinsic Calibration of LiDAR and Camera, ICRA 2021"

IMAGE = p2o.Method(
    name="line-idt",
    build=lambda options: lambda image: extract(image, options),
    options=MapOptions,
    summary="Inverse distance transform of grey-level differences along line segments.",
    gives={"image-idt"},
    cite=_CITE,
)

METHOD = p2o.Method(
    name="line-idt",
    build=build,
    summary="Minus the mean of the inverse distance map of image lines at the line points of the sweep.",
    needs={"image-idt", "cloud-edges"},
    gives={"objective"},
    cite=_CITE,
    example=examples.streets(6, "line-idt/line-points", "grid729", perturb="1deg 0.05m", within="0.6deg 0.1m"),
)
