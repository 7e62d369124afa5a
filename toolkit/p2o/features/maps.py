"""Dense maps of the image as a feature: one or several values a pixel, looked up between pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from p2o.arrays import Float, checked
from p2o.features.feature import ImageFeature


@dataclass(frozen=True, eq=False)
class ImageMap(ImageFeature):
    """A map (H, W) or (H, W, C) float over the pixels of one image; derive a class with a `word` for each meaning."""

    values: Float

    def __post_init__(self) -> None:
        shape = (None,) * np.ndim(self.values) if np.ndim(self.values) in (2, 3) else (None, None)
        object.__setattr__(self, "values", checked(f"the map {self.word}", self.values, shape, np.float64))

    def __len__(self) -> int:
        return int(self.values.shape[0] * self.values.shape[1])

    def at(self, uv: Float) -> Float:
        """Return the values (..., C or nothing) at pixels uv (..., 2), bilinear; NaN outside of the picture."""
        height, width = self.values.shape[:2]
        u, v = uv[..., 0], uv[..., 1]
        with np.errstate(invalid="ignore"):
            inside = (u >= 0) & (v >= 0) & (u <= width - 1) & (v <= height - 1)
        u, v = np.where(inside, u, 0.0), np.where(inside, v, 0.0)
        column = np.clip(u.astype(np.int64), 0, max(width - 2, 0))
        row = np.clip(v.astype(np.int64), 0, max(height - 2, 0))
        right, below = np.minimum(column + 1, width - 1), np.minimum(row + 1, height - 1)
        fu, fv = u - column, v - row
        if self.values.ndim == 3:
            fu, fv, inside = fu[..., None], fv[..., None], inside[..., None]
        top = self.values[row, column] * (1 - fu) + self.values[row, right] * fu
        bottom = self.values[below, column] * (1 - fu) + self.values[below, right] * fu
        return np.where(inside, top * (1 - fv) + bottom * fv, np.nan)


@dataclass(frozen=True, eq=False)
class GreyMap(ImageMap):
    """Grey values (H, W), 0 to 255: what mutual information compares with reflectance."""

    word: ClassVar[str] = "image-grey"
