"""A plugin of the tests: mutual information of grey values and reflectance, after Pandey et al. (AAAI 2012)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Float, Int
from p2o.solving import Objective, hidden
from scipy.ndimage import gaussian_filter


class GreyOptions(p2o.Options):
    sigma_px: float = p2o.field(1.0, ge=0, le=50, help="Width of the Gaussian that smooths the picture.")


def build_grey(options: GreyOptions) -> p2o.ImageExtractor:
    """Return the extractor of grey values of which every one is as frequent as any other."""

    def extract(image: p2o.Image) -> p2o.ImageFeatures:
        import cv2

        grey = gaussian_filter(cv2.equalizeHist(np.asarray(image.grey)).astype(float), options.sigma_px)
        return p2o.ImageFeatures(features=[p2o.GreyMap(grey)])

    return extract


class ReflectanceOptions(p2o.Options):
    points: int = p2o.field(12_000, ge=100, le=1_000_000, help="Points of a sweep that are kept, at most.")
    max_range_m: float = p2o.field(60.0, gt=1, le=1000, help="Points farther off are left out.")


def build_reflectance(options: ReflectanceOptions) -> p2o.CloudExtractor:
    """Return the extractor of points with their intensity, spread evenly over the sweep."""

    def extract(cloud: p2o.Cloud) -> p2o.CloudFeatures:
        near = np.linalg.norm(cloud.xyz, axis=1) <= options.max_range_m
        time_s = None if cloud.time_s is None or cloud.twist is not None else cloud.time_s[near]
        strength = None if cloud.intensity is None else cloud.intensity[near]
        found = p2o.CloudPoints(cloud.xyz[near], strength, time_s=time_s)
        # Sorted by place: points in another order are the same sweep.
        return p2o.CloudFeatures(points=found.select(np.lexsort(found.xyz.T)).thinned(options.points))

    return extract


class InformationOptions(p2o.Options):
    bins: int = p2o.field(16, ge=2, le=256, help="Bins of grey values, and of reflectance.")
    kernel_bins: float = p2o.field(1.0, ge=0, le=10, help="Width of the Gaussian that smooths the histogram, in bins.")
    blur: float = p2o.field(0.1, ge=0, le=1, help="The picture is blurred by this share of the reach.")


@dataclass(frozen=True, eq=False)
class Seen:
    """Points of one view that the camera sees at the pose that they were chosen at; `level` (K,) counts strengths."""

    camera: p2o.Camera
    grey: p2o.GreyMap
    xyz: Float
    level: Int
    options: InformationOptions

    def information(self, poses: Float) -> Float:
        """Return the normalised mutual information (B,) at poses (B, 4, 4): 1 for none, 2 where one tells the other.

        A point that a pose puts out of the picture counts as if its grey were drawn at random: it tells nothing.
        """
        bins, count = self.options.bins, len(self.level)
        grey = self.grey.at(self.camera.project(p2o.se3.apply(poses, self.xyz))) * ((bins - 1) / 255)
        inside = np.isfinite(grey)
        low = np.clip(np.where(inside, grey, 0.0).astype(np.int64), 0, bins - 2)
        share = np.where(inside, grey - low, 0.0)
        cell = (np.arange(len(poses))[:, None] * bins + self.level) * bins + low
        joint = np.zeros(len(poses) * bins * bins)
        for step, weight in ((0, np.where(inside, 1 - share, 0.0)), (1, share)):
            joint += np.bincount((cell + step).ravel(), weight.ravel(), joint.size)
        joint = gaussian_filter(joint.reshape(-1, bins, bins), (0, *[self.options.kernel_bins] * 2), mode="nearest")
        left = np.maximum(joint.sum((1, 2), keepdims=True), 1e-9)
        apart = joint.sum(2, keepdims=True) * joint.sum(1, keepdims=True) / left**2
        together = (joint + (count - left) * apart) / count
        single = _entropy(together.sum(2)) + _entropy(together.sum(1))
        return np.asarray(single / np.maximum(_entropy(together.reshape(len(poses), -1)), 1e-9))


def _entropy(shares: Float) -> Float:
    return np.asarray(-(shares * np.log(np.maximum(shares, 1e-12))).sum(axis=-1))


def build_information(options: InformationOptions) -> p2o.Matcher:
    """Return the matcher `(views, camera_from_lidar (4, 4), reach_px) -> Objective`: minus the mean information."""

    def seen(view: p2o.View, pose: Float, reach_px: float) -> Seen | None:
        grey, points = view.get("image-grey"), view.get("cloud-points")
        if grey is None or points is None or points.intensity is None:
            return None
        keep = view.camera.in_image(view.camera.project(p2o.se3.apply(pose, points.xyz)))
        keep &= ~hidden(points.xyz, points.xyz, view.camera, pose)
        if not keep.any():
            return None
        strength = points.intensity[keep]
        # By rank, so that every level of reflectance is about as frequent as any other.
        rank = np.searchsorted(np.sort(strength), strength) / len(strength)
        level = np.minimum((rank * options.bins).astype(np.int64), options.bins - 1)
        blurred = replace(grey, values=gaussian_filter(grey.values, options.blur * reach_px))
        return Seen(view.camera, blurred, points.xyz[keep], level, options)

    def match(views: Sequence[p2o.View], camera_from_lidar: Float, reach_px: float) -> Objective:
        known = [part for view in views if (part := seen(view, camera_from_lidar, reach_px)) is not None]

        def cost(poses: Float) -> Float:
            return -np.mean([part.information(poses) for part in known], axis=0) if known else np.zeros(len(poses))

        return Objective(cost)

    return match


@p2o.hookimpl
def p2o_image_extractors():
    """Offer the image side."""
    summary = "Grey values, equalised and smoothed."
    yield p2o.Method(name="blurred-grey", build=build_grey, options=GreyOptions, summary=summary, gives={"image-grey"})


@p2o.hookimpl
def p2o_cloud_extractors():
    """Offer the LiDAR side."""
    words = {"summary": "Points with their intensity.", "needs": {"intensity"}, "gives": {"cloud-points"}}
    yield p2o.Method(name="plain-reflectance", build=build_reflectance, options=ReflectanceOptions, **words)


@p2o.hookimpl
def p2o_matchers():
    """Offer the matcher."""
    yield p2o.Method(
        name="mutual-information",
        build=build_information,
        options=InformationOptions,
        summary="Minus the normalised mutual information of grey values and reflectance at the points that are seen.",
        needs={"image-grey", "cloud-points"},
        gives={"objective"},
        cite="Pandey et al., Automatic targetless extrinsic calibration by maximizing mutual information, AAAI 2012",
    )
