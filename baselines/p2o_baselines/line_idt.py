"""Lines of the sweep on the inverse distance transform of image lines, `--matcher line-idt`.

With `--extractor line-idt/line-points --solver coordinate --init given`.

After Zhang et al., Line-Based Automatic Extrinsic Calibration of LiDAR and Camera, ICRA 2021: the row "line-based" of
Table II of P2O-Calib. The features of Levinson and Thrun, but for lines only, and a search with steps that adapt.

- Image: the largest grey-level difference of a pixel to its eight neighbours, kept within `width_px` of the line
  segments that LSD finds; then the inverse distance transform with alpha = 1/3 and gamma = 0.98.
- Sweep: `line-points`; they join three sweeps, `--accumulate poses --set accumulate.past=2 --set accumulate.future=0`.
  One sweep does too, with fewer points.
- Cost: minus the weighted mean of D(u_i) over the points; solver `coordinate`.
- Start: they begin within 1.0 deg and 0.05 m. From there eight starts, on ten simulated streets together, end 0.21 to
  0.60 deg from the truth (median 0.34 deg, 5.4 cm), and with `grid729`, which falls into fewer of the many small
  minima, 0.19 to 0.68 (0.23 deg, 4.4 cm). Single simulated frames end about where they began. They publish about 0.39
  deg on KITTI.

Departures: the text of the paper was not at hand. That images lines are told by LSD, all constants of `line-points` and
the search's steps are ours; a point that leaves the image counts as the mean of D, as in `idt`.

Its temporal successor (Wang et al., Temporal and Spatial Online Integrated Calibration for Camera and LiDAR, ITSC 2022)
estimates the delay between the sensors from visual and LiDAR odometry first, and then refines as above: `line_time`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import p2o
from p2o.arrays import Float

from p2o_baselines.inverse_distance import InverseDistanceMap, edge_strength, inverse_distance, mean_on_maps, on_maps
from p2o_baselines.lsd import segments


class ImageOptions(p2o.Options):
    """Options of the image extractor `line-idt`."""

    alpha: float = p2o.field(1 / 3, ge=0, le=1, help="Share of the edge image itself in the map.")
    gamma: float = p2o.field(0.98, gt=0.5, lt=1, help="What is left of an edge one pixel away from it.")
    min_length_px: float = p2o.field(15.0, ge=0, help="Shortest line segment, in pixels.")
    width_px: int = p2o.field(3, ge=1, le=50, help="Edges within a stroke of this width along a segment are kept.")


def build_image(options: ImageOptions) -> p2o.ImageExtractor:
    """Return the extractor of the inverse distance map of lines."""
    import cv2

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        strength = edge_strength(image.grey)
        strokes = np.zeros(strength.shape, np.uint8)
        for first, last in np.rint(segments(image, options.min_length_px)).astype(int).tolist():
            cv2.line(strokes, first, last, 1, options.width_px)
        strength *= strokes
        return p2o.ImageFeatures(
            features=[InverseDistanceMap(inverse_distance(strength, options.alpha, options.gamma))]
        )

    return extract


class LineIdtOptions(p2o.Options):
    """Options of the matcher `line-idt`."""

    max_points: int = p2o.field(2000, ge=10, help="Line points of a frame that are looked up, at most.")


def build(options: LineIdtOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`."""

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> p2o.Objective:
        parts = on_maps(views, camera_from_lidar, options.max_points)
        return p2o.Objective(lambda poses: -mean_on_maps(parts, poses), lasting=True)

    return match


_CITE = "Zhang et al., Line-Based Automatic Extrinsic Calibration of LiDAR and Camera, ICRA 2021"

IMAGE = p2o.Method(
    name="line-idt",
    build=build_image,
    options=ImageOptions,
    summary="Inverse distance transform of grey-level differences along line segments.",
    gives={"image-idt"},
    cite=_CITE,
)

METHOD = p2o.Method(
    name="line-idt",
    build=build,
    options=LineIdtOptions,
    summary="Minus the mean of the inverse distance map of image lines at the line points of the sweep.",
    needs={"image-idt", "cloud-edges"},
    gives={"objective"},
    cite=_CITE,
    example=p2o.Example(
        "synthetic:?scenes=6&place=street",
        perturb="1deg 0.05m",
        within="0.6deg 0.1m",
        joint=True,
        extractor="line-idt/line-points",
        solver="grid729",
        init="given",
    ),
)
