"""Samples as tensors, and a network's raw numbers as corrections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
import torch
import torch.nn.functional as F
from p2o import UInt8
from torch import Tensor

from p2o_baselines.regressors import poses
from p2o_baselines.regressors.sample import AugmentedSample


@dataclass(frozen=True, eq=False)
class Batch:
    """Samples in windows one after the other: `window` consecutive samples are frames of one drive.

    `image` (B, 3, h, w) in 0..1, `sweep` (B, C, h, w), `reach` (B, 2) in rad and m; `correction` (B, 4, 4), `xyz` (B,
    P, 3), `intrinsics` (B, 4), `true_nearness` (B, h, w), `hand_eye` (B, 2, 4, 4) and `start` (B, 4, 4) as in
    `AugmentedSample`.
    """

    image: Tensor
    sweep: Tensor
    reach: Tensor
    correction: Tensor
    xyz: Tensor
    intrinsics: Tensor
    true_nearness: Tensor
    hand_eye: Tensor
    start: Tensor
    window: int = 1

    @classmethod
    def of(cls, samples: Sequence[AugmentedSample], window: int, device: torch.device) -> Batch:
        """Return the batch of samples."""
        arrays = {f.name: np.stack([getattr(each, f.name) for each in samples]) for f in fields(AugmentedSample)}
        image = image_tensor(arrays.pop("rgb"), device)
        tensors = {name: torch.from_numpy(array).to(device).float() for name, array in arrays.items()}
        return cls(image, **tensors, window=window)


def image_tensor(rgb: UInt8, device: torch.device) -> Tensor:
    """Return images (B, 3, h, w) in 0..1 of (B, h, w, 3) uint8."""
    return torch.from_numpy(rgb).to(device).permute(0, 3, 1, 2).float() / 255


def correction(raw: Tensor, reach: Tensor, form: str) -> Tensor:
    """Return the corrections (B, 4, 4) of raw numbers (B, n), in units of the reach (B, 2); zero is none."""
    turn, shift = reach[:, :1], reach[:, 1:]
    if form == "rotation-vector":
        return poses.pose(poses.rotation(raw[:, :3] * turn), raw[:, 3:] * shift)
    if form == "quaternion":
        return poses.pose(poses.quaternion_rotation(quaternion(raw[:, :4], turn)), raw[:, 4:] * shift)
    real = quaternion(raw[:, :4], turn)
    # Relative to the real part, as the dual part of a pose is t q / 2.
    return poses.dual_quaternion_pose(torch.cat([real, 0.5 * poses.product(raw[:, 4:] * shift, real)], dim=1))


def quaternion(raw: Tensor, turn: Tensor) -> Tensor:
    """Return unit quaternions (B, 4) of raw numbers (B, 4) that count in angles (B, 1)."""
    return F.normalize(torch.cat([1 + 0.1 * raw[:, :1], 0.5 * turn * raw[:, 1:]], dim=1), dim=1)
