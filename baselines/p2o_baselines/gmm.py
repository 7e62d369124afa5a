"""Projected LiDAR edges in a Gaussian mixture of the image's edge pixels, whose width shrinks, `--matcher gmm`.

Kang and Doh, Automatic Targetless Camera-LiDAR Calibration by Aligning Edge with Gaussian Mixture Model, JFR 2020:
maximise sum_i sum_j w_ij exp(-|u_i - q_j|^2 / (2 s^2)) over LiDAR edges u_i and image edge pixels q_j, for widths s
that shrink. Takes the edges of any image and cloud extractor, without their sides.

- w_ij is the mean of the weights of both edges, over the number of image edges within 3 s in u and v, so that textured
  places count no more than others (as a public student re-implementation has it, ctyfang/amz-targetless-cal).
- s is `width` times the reach of the round, which shrinks from round to round, and at least `min_width_px`.
- Judge: the mixture at the smallest width, at the points that the start brings near the image.
- Solver: `coordinate` (they: `nelder-mead` from many starts; it takes ten times as long).
- Basin: from 2 deg and 10 cm on four simulated streets together five of five starts come back with `width` 0.2, with
  canny/line-points to 0.07 deg and 3 cm; on three streets together one start of one ran away to 4 deg. With 0.4 and
  wider, which should reach further, some run away by metres.

Departures: pairs beyond 3 s in u or v count nothing. The mixture is summed up in pictures once a round and looked up
between pixels, which takes any number of poses at once: at pixels that is the sum over all pairs where edges lie on
pixels (those of Canny do), between them it is up to an eighth lower an axis at s = 1 px, a hundredth at 3 px. One s for
all points rather than one that shrinks with range; no mutual information beside it; no basin hopping. A LiDAR edge
outside the image counts as the mean of the mixture, which neither favours nor punishes leaving it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import p2o
from p2o.arrays import Float
from scipy.ndimage import gaussian_filter, uniform_filter

from p2o_baselines.inverse_distance import OnMap


class GmmOptions(p2o.Options):
    """Options of `gmm`."""

    width: float = p2o.field(0.2, gt=0, le=2, help="Width of the Gaussians as a share of the reach.")
    min_width_px: float = p2o.field(1.0, ge=0.5, le=50, help="Smallest width of the Gaussians.")
    max_points: int = p2o.field(1000, ge=10, help="LiDAR edges of a frame that take part, at most.")
    margin_px: float = p2o.field(100.0, ge=0, help="LiDAR edges this far outside the image still take part.")


def scattered(shape: tuple[int, int], uv: Float, weight: Float) -> Float:
    """Return a picture (H, W) with the weights (N,) of points uv (N, 2) px, each shared by four pixels."""
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
    """Return two pictures (H, W): sums over edges of exp(-d^2 / (2 s^2)), bare and times their weights.

    Both are divided by the number of edges within 3 s in u and v, or by 1 where there are fewer.
    """
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
    def of(cls, views: Sequence[p2o.View], around: Float, width_px: float, options: GmmOptions) -> Mixture:
        """Return the cost of the LiDAR edges that a pose (4, 4) brings into the image, or near it."""
        parts = []
        for view in views:
            edges, image = view.cloud_edges, view.image_edges
            if not len(edges) or not len(image):
                continue
            uv = view.camera.project(p2o.se3.apply(around, edges.xyz))
            near = edges.select(view.camera.in_image(uv, options.margin_px)).thinned(options.max_points)
            first, second = mixtures((view.camera.height, view.camera.width), image.uv, image.weight, width_px)
            both = [(first, 0.5 * near.weight), (second, np.full(len(near), 0.5))]
            if (image.weight == image.weight[0]).all():  # one picture is a multiple of the other
                both = [(first, 0.5 * (near.weight + image.weight[0]))]
            parts += [OnMap(view.camera, at, near.xyz, weight, float(at.mean())) for at, weight in both]
        return cls(tuple(parts))

    def cost(self, poses: Float) -> Float:
        """Return the cost (B,) of poses (B, 4, 4); 0 without any edges."""
        weight = sum(float(part.weight.sum()) for part in self.parts)
        total = sum((part.sums(poses) for part in self.parts), np.zeros(len(poses)))
        return np.asarray(-total / weight if weight > 0 else total)


@dataclass(frozen=True, eq=False)
class GmmJudge:
    """Judges by the mixture of the smallest width, all poses on the points that are near the image at `around`."""

    views: tuple[p2o.View, ...]
    around: Float
    options: GmmOptions
    name: str = "gmm"
    unit: str = "mixture"

    def __post_init__(self) -> None:
        found = Mixture.of(self.views, self.around, self.options.min_width_px, self.options)
        object.__setattr__(self, "_mixture", found)

    def costs(self, poses: Sequence[Float]) -> list[float]:
        """Return the cost of each pose (4, 4)."""
        mixture: Mixture = self._mixture  # type: ignore[attr-defined]
        costs: list[float] = mixture.cost(np.stack(poses)).tolist()
        return costs

    def lead(self, best: float, other: float) -> tuple[float, str]:
        """Return the difference of the costs."""
        return other - best, self.unit

    def on(self, views: Sequence[p2o.View]) -> GmmJudge:
        """Return the judge of other views."""
        return GmmJudge(tuple(views), self.around, self.options)


@dataclass(frozen=True)
class Gmm:
    """The matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`, with a judge of its own."""

    options: GmmOptions

    def __call__(self, views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> p2o.Objective:
        width_px = max(self.options.width * reach_px, self.options.min_width_px)
        return p2o.Objective(Mixture.of(views, camera_from_lidar, width_px, self.options).cost)

    def judge(self, views: Sequence[p2o.View], start: Float, poses: Sequence[Float]) -> GmmJudge:
        """Return what poses of one calibration are compared by."""
        return GmmJudge(tuple(views), start, self.options)


def build(options: GmmOptions) -> p2o.Matcher:
    """Return the matcher."""
    return Gmm(options)


METHOD = p2o.Method(
    name="gmm",
    build=build,
    options=GmmOptions,
    summary="Minus the Gaussian mixture of image edge pixels at the cloud edges, narrower from round to round.",
    needs={"image-edges", "cloud-edges"},
    gives={"objective"},
    cite="Kang and Doh, Automatic Targetless Camera-LiDAR Calibration by Aligning Edge with GMM, JFR 2020",
    example=p2o.Example(
        "synthetic:?scenes=4&place=street",
        perturb="1deg 0.1m",
        within="0.25deg 0.08m",
        joint=True,
        extractor="canny/line-points",
        solver="coordinate",
        init="given",
    ),
)
