"""Align LiDAR edges with a Gaussian mixture of image edge pixels, `--matcher gmm`; its width shrinks.

Kang and Doh, Automatic Targetless Camera-LiDAR Calibration by Aligning Edge with Gaussian Mixture Model, JFR 2020:
maximise sum_i sum_j w_ij exp(-|u_i - q_j|^2 / (2 s^2)) over LiDAR edges u_i and image edge pixels q_j, for decreasing
widths s. Accepts the edges of any image and cloud extractor; sides are ignored.

- w_ij is the mean of the weights of both edges, divided by the number of image edges within 3 s in u and v, so that
  textured regions have the same weight as others (as in a public re-implementation by students,
  ctyfang/amz-targetless-cal).
- s is 0.2 times the reach of the round, which shrinks from round to round, and at least 1 px.
- Judge: the mixture at the smallest width, at the points that the initial extrinsic projects near the image.
- Solver: `coordinate` (original: `nelder-mead` from many initial poses, which takes ten times as long).
- Basin of attraction: in joint calibration of four synthetic streets, five of five initial errors of 2 deg and 10 cm
  converge with that factor and canny/line-points to 0.07 deg and 3 cm; on three streets, one result diverged to 4 deg.
  With 0.4 and wider, some diverge by metres.

Departures: pairs beyond 3 s in u or v are ignored. The mixture is rendered once per round and interpolated between
pixels, so that many poses are evaluated at once: at pixels it equals the sum over all pairs if edges lie on pixels
(those of Canny do), between them it is up to an eighth lower per axis at s = 1 px, a hundredth at 3 px. One s for all
points instead of one that decreases with range; no additional mutual information; no basin hopping. A LiDAR edge
outside the image scores the mean of the mixture, which neither favours nor penalises leaving it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import p2o
from p2o import Float
from p2o.solving import Objective
from scipy.ndimage import gaussian_filter, uniform_filter

from p2o_baselines import examples
from p2o_baselines.edges.inverse_distance import OnMap, mean_on_maps

_MIN_WIDTH_PX = 1.0  # smallest width of the Gaussians
_MARGIN_PX = 100.0  # LiDAR edges this far outside the image still take part
_WIDTH = 0.2  # width of the Gaussians as a share of the reach
_MAX_POINTS = 1000  # LiDAR edges of a frame that take part, at most


def scattered(shape: tuple[int, int], uv: Float, weight: Float) -> Float:
    """Return an image (H, W) with the weights (N,) of points uv (N, 2) px, each shared by four pixels."""
    height, width = shape
    low = np.floor(uv).astype(np.int64)
    share = uv - low
    out = np.zeros(height * width)
    for du in (0, 1):
        for dv in (0, 1):
            u, v = low[:, 0] + du, low[:, 1] + dv
            part = weight * np.abs(1 - du - share[:, 0]) * np.abs(1 - dv - share[:, 1])
            inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
            out += np.bincount((v * width + u)[inside], part[inside], out.size)
    return out.reshape(height, width)


def mixtures(shape: tuple[int, int], uv: Float, weight: Float, width_px: float) -> tuple[Float, Float]:
    """Return sums of exp(-d^2 / (2 s^2)) over edges, without and with weights, over the number within 3 s: (H, W)."""
    bare, heavy = scattered(shape, uv, np.ones(len(uv))), scattered(shape, uv, weight)
    reach = int(3 * width_px + 0.5)
    count = uniform_filter(bare, 2 * reach + 1, mode="constant") * (2 * reach + 1) ** 2
    # The filter's weights sum to one; the mixture's peaks are one.
    peak = gaussian_filter(np.eye(1, 2 * reach + 1, reach)[0], width_px, mode="constant", truncate=3.0)[reach] ** 2
    blurred = (gaussian_filter(part, width_px, mode="constant", truncate=3.0) / peak for part in (bare, heavy))
    first, second = (part / np.maximum(count, 1.0) for part in blurred)
    return first, second


@dataclass(frozen=True, eq=False)
class Mixture:
    """The cost: minus the mean of sum_j w_ij exp(-d^2 / (2 s^2)) over the LiDAR edges."""

    parts: tuple[OnMap, ...]

    @classmethod
    def of(cls, views: Sequence[p2o.View], around: Float, width_px: float) -> Mixture:
        """Return the cost of the LiDAR edges that a pose (4, 4) brings into the image, or near it."""
        parts = []
        for view in views:
            edges, image = view.cloud_edges, view.image_edges
            if not len(edges) or not len(image):
                continue
            uv = view.camera.project(p2o.se3.apply(around, edges.xyz))
            near = edges.select(view.camera.in_image(uv, _MARGIN_PX)).thinned(_MAX_POINTS)
            first, second = mixtures((view.camera.height, view.camera.width), image.uv, image.weight, width_px)
            both = [(first, 0.5 * near.weight), (second, np.full(len(near), 0.5))]
            if (image.weight == image.weight[0]).all():  # one image is a multiple of the other
                both = [(first, 0.5 * (near.weight + image.weight[0]))]
            parts += [OnMap(view.camera, at, near.xyz, weight, float(at.mean())) for at, weight in both]
        return cls(tuple(parts))

    def cost(self, poses: Float) -> Float:
        """Return the cost (B,) of poses (B, 4, 4); 0 without any edges."""
        return -mean_on_maps(self.parts, poses)


@dataclass(frozen=True, eq=False)
class GmmJudge(p2o.JudgeBase):
    """Judges by the mixture of the smallest width, all poses on the points that are near the image at `around`."""

    views: tuple[p2o.View, ...]
    around: Float
    name: str = "gmm"
    unit: str = "mixture"

    @cached_property
    def _mixture(self) -> Mixture:
        return Mixture.of(self.views, self.around, _MIN_WIDTH_PX)

    def costs(self, poses: Sequence[Float]) -> list[float]:
        """Return the cost of each pose (4, 4)."""
        costs: list[float] = self._mixture.cost(np.stack(poses)).tolist()
        return costs

    def on(self, views: Sequence[p2o.View]) -> GmmJudge:
        """Return the judge for other views."""
        return GmmJudge(tuple(views), self.around)


@dataclass(frozen=True)
class Gmm(p2o.MatcherBase):
    """The matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`, with a judge of its own."""

    def __call__(self, views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        width_px = max(_WIDTH * reach_px, _MIN_WIDTH_PX)
        return Objective(Mixture.of(views, camera_from_lidar, width_px).cost)

    def judge(self, views: Sequence[p2o.View], start: Float, poses: Sequence[Float]) -> GmmJudge:
        """Return what poses of one calibration are compared by."""
        return GmmJudge(tuple(views), start)


METHOD = p2o.Method(
    name="gmm",
    build=lambda options: Gmm(),
    summary="Minus the Gaussian mixture of image edge pixels at the cloud edges, narrower from round to round.",
    needs={"image-edges", "cloud-edges"},
    gives={"objective"},
    cite="Kang and Doh, Automatic Targetless Camera-LiDAR Calibration by Aligning Edge with GMM, JFR 2020",
    example=examples.streets(4, "canny/line-points", "coordinate", perturb="1deg 0.1m", within="0.25deg 0.08m"),
)
