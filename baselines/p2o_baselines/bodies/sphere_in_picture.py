"""Spheres in an image of any camera: their contours, as the cones of rays that touch them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import p2o
from p2o import Float, Sphere

from p2o_baselines.bodies.colour_regions import Region, Single, at_border, linear_light, regions, step_at

_LEAST_RADIUS_PX = 7.0
_AROUND, _REACH_PX, _STEPS_A_PX = 180, 5.0, 4  # number of samples of a contour, and range and spacing across it
_LEAST_FIT, _LEAST_AROUND = 0.75, 0.7  # least share of a region's outline, and of all directions, on one cone
_FLOOR_PX = 0.1  # no place of a contour is taken to be better known
_TOGETHER = 3.0  # number of neighbours, or pixels, with a common error: they are averaged, and the lens blurs steps


@dataclass(frozen=True)
class SphereInPicture:
    """A sphere in an image: tangent rays (N, 3) and their cone, its scatter in rad, and the image's scale."""

    target: Sphere
    rays: Float
    axis: Float
    half_rad: float
    sigma_rad: float
    px_per_rad: float

    @property
    def centre(self) -> Float:
        """Return the centre (3,) m in the camera frame, at the distance that follows from radius and cone."""
        return np.asarray(self.axis * self.target.radius_m / np.sin(self.half_rad))


def cone_of(rays: Float) -> tuple[Float, float]:
    """Return axis (3,) and half angle (rad) of the cone nearest to unit rays (N, 3): their tips lie in a plane."""
    normal = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)[0]
    axis = normal / np.linalg.norm(normal)
    half = float(np.arccos(np.clip(1 / np.linalg.norm(normal), -1, 1)))
    for _ in range(10):
        angle, by_axis = _angles(rays, axis)
        rows = np.column_stack([by_axis, -np.ones(len(rays))])
        step = np.linalg.lstsq(rows, half - angle, rcond=None)[0]
        axis = axis + step[:3]
        axis, half = axis / np.linalg.norm(axis), half + float(step[3])
        if np.abs(step).max() < 1e-13:
            break
    return axis, half


def _angles(rays: Float, axis: Float) -> tuple[Float, Float]:
    """Return angles (N,) of rays from an axis and their derivatives (N, 3) by the axis, across it."""
    cosine = rays @ axis
    sine = np.linalg.norm(np.cross(rays, axis), axis=1)
    by_axis = -(rays - cosine[:, None] * axis) / np.maximum(sine, 1e-9)[:, None]
    return np.arctan2(sine, cosine), by_axis


def spheres_in_picture(image: p2o.Image, targets: Sequence[p2o.Target]) -> tuple[SphereInPicture, ...]:
    """Return candidates of spheres in an image, one per size: regions of one colour with the outline of a cone."""
    sizes = list(dict.fromkeys(target for target in targets if isinstance(target, Sphere)))
    if not sizes:
        return ()
    detected: list[SphereInPicture] = []
    light = linear_light(image.rgb)
    for region in regions(image.rgb, np.pi * _LEAST_RADIUS_PX**2):
        ball = _ball(light, image.camera, region, sizes[0])
        if ball is None:
            continue
        same = [n for n, known in enumerate(detected) if known.axis @ ball.axis > np.cos(0.5 * known.half_rad)]
        if not same:
            detected.append(ball)
        elif len(ball.rays) > len(detected[same[0]].rays):
            detected[same[0]] = ball
    return tuple(replace(ball, target=size) for size in sizes for ball in detected)


def _ball(light: Single, camera: p2o.Camera, region: Region, size: Sphere) -> SphereInPicture | None:
    """Return the sphere of a region; None if its outline is no cone, or truncated by the border of the image."""
    uv = region.contour[~at_border(region.contour, camera.width, camera.height)]
    if len(uv) < 0.8 * len(region.contour) or _too_long(region):
        return None
    rays = camera.rays(uv)
    rays = rays[np.isfinite(rays).all(axis=1)]
    if len(rays) < 20:
        return None
    scale = np.sqrt(region.area / np.pi)  # radius in pixels
    axis, half = cone_of(rays)
    for _ in range(4):  # without protrusions, such as the pole
        off = np.abs(_angles(rays, axis)[0] - half)
        kept = off < max(2.5 * float(np.median(off)), 1.0 * half / scale)
        if kept.sum() < 12:
            return None
        axis, half = cone_of(rays[kept])
    if not 0 < half < 1.0:
        return None
    off_px = np.abs(_angles(rays, axis)[0] - half) * scale / half
    if (off_px < 1.5 + 0.02 * scale).mean() < _LEAST_FIT:
        return None
    return _refined(light, camera, axis, half, size)


def _too_long(region: Region) -> bool:
    low, high = region.contour.min(axis=0), region.contour.max(axis=0)
    wide, tall = high - low + 1
    return bool(max(wide, tall) > 2.5 * min(wide, tall) or region.area < 0.5 * wide * tall)


def _refined(light: Single, camera: p2o.Camera, axis: Float, half: float, size: Sphere) -> SphereInPicture | None:
    """Return the ball by steps of colour along the radii of its cone, to a fraction of a pixel."""
    for _ in range(2):
        side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        side /= np.linalg.norm(side)
        other = np.cross(axis, side)
        turn = 2 * np.pi * np.arange(_AROUND) / _AROUND
        radial = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * other

        def uv_at(angle: Float, radial: Float = radial, axis: Float = axis) -> Float:
            rays = np.cos(angle)[..., None] * axis + np.sin(angle)[..., None] * radial[:, None]
            return np.asarray(camera.project(rays))

        near = uv_at(np.array([half - 1e-4, half + 1e-4]))
        if not np.isfinite(near).all():
            return None
        per_rad = np.linalg.norm(near[:, 1] - near[:, 0], axis=1) / 2e-4
        reach = min(_REACH_PX, 0.4 * half * float(np.median(per_rad)))
        steps = np.linspace(-reach, reach, 2 * round(reach * _STEPS_A_PX) + 1)
        places = uv_at(half + steps / per_rad[:, None])
        if not np.isfinite(places).all():
            return None
        at = step_at(light, places, 0.5 * (len(steps) - 1) * 0.7)
        known = np.isfinite(at)
        if known.mean() < _LEAST_AROUND:
            return None
        angles = half + np.interp(at[known], np.arange(len(steps)), steps) / per_rad[known]
        rays = np.cos(angles)[:, None] * axis + np.sin(angles)[:, None] * radial[known]
        for _ in range(4):
            axis, half = cone_of(rays)
            off = _angles(rays, axis)[0] - half
            spread = 1.4826 * float(np.median(np.abs(off)))
            rays = rays[np.abs(off) < max(3.0 * spread, 0.3 * _FLOOR_PX / float(np.median(per_rad)))]
        if len(rays) < _LEAST_AROUND * 0.85 * _AROUND:
            return None
    scale = float(np.median(per_rad))
    off = _angles(rays, axis)[0] - half
    rms = float(np.sqrt(np.mean(off**2)))
    if rms * scale > 0.6 + 0.004 * half * scale:
        return None
    # Places nearer to each other than the lens's spot are one measurement.
    apart_px = 2 * np.pi * half * scale / _AROUND
    together = max(_TOGETHER, _TOGETHER / apart_px)
    return SphereInPicture(size, rays, axis, half, max(rms, _FLOOR_PX / scale) * float(np.sqrt(together)), scale)
