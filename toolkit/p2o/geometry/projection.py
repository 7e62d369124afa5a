"""Closed-form projections of common camera models, vectorised.

Models and the order of parameters are those of COLMAP (src/colmap/sensor/models.h); pixels have the origin of the
principal point. Models that are not in `LENSES` use pycolmap. All functions keep the precision of their input.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from p2o.arrays import Float

_ON_AXIS = 1e-6
"""Up to this squared tangent, the derivative of the fisheye factor on the axis is used, because of cancellation."""

_MOST_STEPS, _LEAST_STEP = 50, 1e-13
"""Newton steps of an inverse projection, and the step below which the next one is not needed."""


@dataclass(frozen=True)
class Lens:
    """The indices of the parameters of a camera model.

    The first `focal` parameters are focal lengths, followed by the principal point. `radial` are the indices of the
    coefficients of even powers of the tangent, or of the angle for a `fisheye`, `below` those of the denominator,
    `tangential` those of p1 and p2. `count` is the number of parameters.
    """

    focal: int
    count: int
    radial: tuple[int, ...] = ()
    below: tuple[int, ...] = ()
    tangential: tuple[int, ...] = ()
    fisheye: bool = False

    @property
    def names(self) -> str:
        """Names of the parameters, in their order."""
        names = {index: f"k{number}" for number, index in enumerate((*self.radial, *self.below), 1)}
        names |= {index: f"p{number}" for number, index in enumerate(self.tangential, 1)}
        head = ["f"] if self.focal == 1 else ["fx", "fy"]
        return ", ".join([*head, "cx", "cy", *(names[index] for index in sorted(names))])


LENSES = {
    "SIMPLE_PINHOLE": Lens(1, 3),
    "PINHOLE": Lens(2, 4),
    "SIMPLE_RADIAL": Lens(1, 4, (3,)),
    "RADIAL": Lens(1, 5, (3, 4)),
    "OPENCV": Lens(2, 8, (4, 5), tangential=(6, 7)),
    "FULL_OPENCV": Lens(2, 12, (4, 5, 8), (9, 10, 11), (6, 7)),
    "SIMPLE_RADIAL_FISHEYE": Lens(1, 4, (3,), fisheye=True),
    "RADIAL_FISHEYE": Lens(1, 5, (3, 4), fisheye=True),
    "OPENCV_FISHEYE": Lens(2, 8, (4, 5, 6, 7), fisheye=True),
}


@dataclass(frozen=True)
class Projection:
    """A lens with its parameters, mapping the plane z = 1 to pixels."""

    lens: Lens
    params: tuple[float, ...]

    @property
    def focal(self) -> tuple[float, float]:
        """Focal lengths in pixels, along u and v."""
        return self.params[0], self.params[self.lens.focal - 1]

    @property
    def centre(self) -> tuple[float, float]:
        """The principal point in pixels."""
        return self.params[self.lens.focal], self.params[self.lens.focal + 1]

    def pixels(self, a: Float, b: Float) -> tuple[Float, Float]:
        """Return pixels u, v of points of the plane z = 1, a = x / z and b = y / z, of equal shape."""
        (fx, fy), (cx, cy) = self.focal, self.centre
        if self.lens.fisheye or any(self.params[self.lens.focal + 2 :]):
            square = a * a + b * b
            factor = self._factor(square)
            u, v = a * factor, b * factor
            if not self.is_radial:
                p1, p2 = self._tangential
                u += 2 * p1 * a * b + p2 * (square + 2 * a * a)
                v += 2 * p2 * a * b + p1 * (square + 2 * b * b)
            u *= fx
            v *= fy
        else:
            u, v = a * fx, b * fy
        u += cx
        v += cy
        return u, v

    def slopes(self, a: Float, b: Float) -> tuple[Float, Float, Float, Float]:
        """Return the derivatives du/da, du/db, dv/da, dv/db in pixels at points of the plane z = 1."""
        fx, fy = self.focal
        factor, steepness = self._factor_and_slope(a * a + b * b)
        mixed = 2 * a * b * steepness
        u_a, v_b, u_b, v_a = factor + 2 * a * a * steepness, factor + 2 * b * b * steepness, mixed, mixed
        if not self.is_radial:
            p1, p2 = self._tangential
            u_a = u_a + 2 * p1 * b + 6 * p2 * a
            v_b = v_b + 2 * p2 * a + 6 * p1 * b
            both = 2 * p1 * a + 2 * p2 * b
            u_b, v_a = u_b + both, v_a + both
        return fx * u_a, fx * u_b, fy * v_a, fy * v_b

    def plane(self, u: Float, v: Float) -> tuple[Float, Float]:
        """Return the points a, b of the plane z = 1 that project to pixels u, v (N,): the inverse of `pixels`.

        Newton's method from the undistorted pixels; on the angle from the axis for a fisheye, which is beyond the plane
        from 90 degrees on. Values are arbitrary for pixels without an inverse.
        """
        (fx, fy), (cx, cy) = self.focal, self.centre
        x, y = (u - cx) / fx, (v - cy) / fy
        if self.lens.fisheye:
            radius, (radial, _) = np.hypot(x, y), self._coefficients
            angle = radius
            for _ in range(_MOST_STEPS):
                square = angle * angle
                value, slope = _polynomial(radial, square), 2 * square * _slope(radial, square)
                step = (angle * value - radius) / (value + slope)
                angle = angle - step
                if not np.abs(step).max(initial=0) > _LEAST_STEP:
                    break
            factor = np.where(radius > 0, np.tan(angle) / np.where(radius > 0, radius, 1), 1.0)
            return x * factor, y * factor
        a, b = x, y
        for _ in range(_MOST_STEPS):
            at_u, at_v = self.pixels(a, b)
            u_a, u_b, v_a, v_b = self.slopes(a, b)
            scale, du, dv = u_a * v_b - u_b * v_a, at_u - u, at_v - v
            step_a, step_b = (v_b * du - u_b * dv) / scale, (u_a * dv - v_a * du) / scale
            a, b = a - step_a, b - step_b
            if not max(np.abs(step_a).max(initial=0), np.abs(step_b).max(initial=0)) > _LEAST_STEP:
                break
        return a, b

    def determinant(self, a: Float, b: Float) -> Float:
        """Return the determinant of the derivatives by a and b at points of the plane z = 1, in px^2."""
        if not self.is_radial:
            u_a, u_b, v_a, v_b = self.slopes(a, b)
            return np.asarray(u_a * v_b - u_b * v_a)
        (fx, fy), square = self.focal, a * a + b * b
        factor, steepness = self._factor_and_slope(square)
        return np.asarray(fx * fy * factor * (factor + 2 * square * steepness))

    def by_first_radial(self, a: Float, b: Float) -> tuple[Float, Float]:
        """Return the derivatives of u and v by the first radial coefficient at points of the plane z = 1."""
        (fx, fy), square = self.focal, a * a + b * b
        if self.lens.fisheye:
            tangent = np.sqrt(np.maximum(square, _ON_AXIS**2))
            factor = np.arctan(tangent) ** 3 / tangent
        else:
            _, below = self._coefficients
            factor = square / _polynomial(below, square) if any(below) else square
        return fx * a * factor, fy * b * factor

    @property
    def _tangential(self) -> tuple[float, ...]:
        return tuple(self.params[i] for i in self.lens.tangential)

    @property
    def is_radial(self) -> bool:
        """Whether the distortion depends on the angle from the axis only."""
        return not any(self._tangential)

    def _factor(self, square: Float) -> Float:
        """Return the radial distortion factor; `square` is the squared tangent of the angle from the axis."""
        radial, below = self._coefficients
        if self.lens.fisheye:
            tangent = np.sqrt(np.maximum(square, _ON_AXIS**2))
            angle = np.arctan(tangent)
            return np.asarray(angle * _polynomial(radial, angle * angle) / tangent)
        above = _polynomial(radial, square)
        return above / _polynomial(below, square) if any(below) else above

    def _factor_and_slope(self, square: Float) -> tuple[Float, Float]:
        """Return the radial distortion factor and its derivative by the square."""
        radial, below = self._coefficients
        factor = self._factor(square)
        if self.lens.fisheye:
            angle = np.arctan(np.sqrt(square))
            angle *= angle
            turn = (_polynomial(radial, angle) + 2 * angle * _slope(radial, angle)) / (1 + square)
            away = np.maximum(square, _ON_AXIS)
            return factor, np.where(square < _ON_AXIS, radial[0] - 1 / 3, (turn - factor) / (2 * away))
        slope = _slope(radial, square)
        if not any(below):
            return factor, slope
        return factor, (slope - factor * _slope(below, square)) / _polynomial(below, square)

    @property
    def _coefficients(self) -> tuple[list[float], list[float]]:
        return [self.params[i] for i in self.lens.radial], [self.params[i] for i in self.lens.below]


def _polynomial(coefficients: list[float], x: Float) -> Float:
    """Return 1 + c1 x + c2 x^2 + ..."""
    value = np.zeros_like(x)
    for coefficient in reversed(coefficients):
        value += coefficient
        value *= x
    value += 1
    return value


def _slope(coefficients: list[float], x: Float) -> Float:
    """Return the derivative of the polynomial by x."""
    value = np.zeros_like(x)
    for power in range(len(coefficients), 0, -1):
        value *= x
        value += power * coefficients[power - 1]
    return value
