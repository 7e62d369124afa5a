"""Rotations, quaternions, dual quaternions and rigid transforms in batches, with gradients that are finite at zero."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

_SMALL = 1e-4


def skew(vector: Tensor) -> Tensor:
    """Return the matrices (..., 3, 3) that take the cross product with vectors (..., 3)."""
    x, y, z = vector.unbind(-1)
    o = torch.zeros_like(x)
    return torch.stack([o, -z, y, z, o, -x, -y, x, o], dim=-1).reshape(*vector.shape[:-1], 3, 3)


def rotation(vector: Tensor) -> Tensor:
    """Return rotations (..., 3, 3) of rotation vectors (..., 3) in rad: the exponential of so(3)."""
    square = (vector * vector).sum(-1)[..., None, None]
    near = square < _SMALL
    # What is not used must be finite too, or its gradient is NaN.
    angle = torch.where(near, torch.ones_like(square), square).sqrt()
    a = torch.where(near, 1 - square / 6, torch.sin(angle) / angle)
    b = torch.where(near, 0.5 - square / 24, (1 - torch.cos(angle)) / angle**2)
    k = skew(vector)
    return torch.eye(3, dtype=vector.dtype, device=vector.device) + a * k + b * (k @ k)


def angle_of(matrix: Tensor) -> Tensor:
    """Return the angles (...,) in rad of rotations (..., 3, 3); gradients are finite at zero rotation."""
    sine = 0.5 * torch.stack(
        [
            matrix[..., 2, 1] - matrix[..., 1, 2],
            matrix[..., 0, 2] - matrix[..., 2, 0],
            matrix[..., 1, 0] - matrix[..., 0, 1],
        ],
        dim=-1,
    )
    cosine = 0.5 * (matrix.diagonal(dim1=-2, dim2=-1).sum(-1) - 1)
    return torch.atan2((sine.square().sum(-1) + 1e-12).sqrt(), cosine)


def quaternion_rotation(quaternion: Tensor) -> Tensor:
    """Return rotations (..., 3, 3) of quaternions (..., 4), w first, of any length above zero."""
    w, x, y, z = F.normalize(quaternion, dim=-1).unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=-1).reshape(*quaternion.shape[:-1], 3, 3)


def quaternion_of(matrix: Tensor) -> Tensor:
    """Return the quaternions (..., 4), w first and not negative, of rotations (..., 3, 3) of less than 180 deg."""
    w = 0.5 * (1 + matrix.diagonal(dim1=-2, dim2=-1).sum(-1)).clamp_min(1e-12).sqrt()
    x = matrix[..., 2, 1] - matrix[..., 1, 2]
    y = matrix[..., 0, 2] - matrix[..., 2, 0]
    z = matrix[..., 1, 0] - matrix[..., 0, 1]
    return F.normalize(torch.stack([w, x / (4 * w), y / (4 * w), z / (4 * w)], dim=-1), dim=-1)


def product(a: Tensor, b: Tensor) -> Tensor:
    """Return the products (..., 4) of quaternions, w first."""
    real = a[..., :1] * b[..., :1] - (a[..., 1:] * b[..., 1:]).sum(-1, keepdim=True)
    rest = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + torch.linalg.cross(a[..., 1:], b[..., 1:])
    return torch.cat([real, rest], dim=-1)


def conjugate(quaternion: Tensor) -> Tensor:
    """Return the conjugates (..., 4)."""
    return quaternion * quaternion.new_tensor([1.0, -1.0, -1.0, -1.0])


def dual_quaternion_of(pose: Tensor) -> Tensor:
    """Return the dual quaternions (..., 8), real part first, of poses (..., 4, 4): the dual part is t q / 2."""
    real = quaternion_of(pose[..., :3, :3])
    shift = F.pad(pose[..., :3, 3], (1, 0))
    return torch.cat([real, 0.5 * product(shift, real)], dim=-1)


def dual_quaternion_pose(dual: Tensor) -> Tensor:
    """Return the poses (..., 4, 4) of dual quaternions (..., 8): the nearest of those that are not exact."""
    length = dual[..., :4].norm(dim=-1, keepdim=True)
    real = dual[..., :4] / length
    shift = 2 * product(dual[..., 4:] / length, conjugate(real))[..., 1:]
    return pose(quaternion_rotation(real), shift)


def pose(rotation: Tensor, shift: Tensor) -> Tensor:
    """Return poses (..., 4, 4) of rotations (..., 3, 3) and shifts (..., 3)."""
    last = rotation.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(*rotation.shape[:-2], 1, 4)
    return torch.cat([torch.cat([rotation, shift[..., None]], dim=-1), last], dim=-2)


def inverse(pose_: Tensor) -> Tensor:
    """Return the inverses (..., 4, 4) of poses."""
    back = pose_[..., :3, :3].transpose(-1, -2)
    return pose(back, -(back @ pose_[..., :3, 3:])[..., 0])


def apply(pose_: Tensor, xyz: Tensor) -> Tensor:
    """Return points (..., N, 3) moved by poses (..., 4, 4)."""
    return xyz @ pose_[..., :3, :3].transpose(-1, -2) + pose_[..., None, :3, 3]
