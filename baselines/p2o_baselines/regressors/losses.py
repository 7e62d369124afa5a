"""Losses of regressed poses, each the mean over a batch."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from p2o_baselines.regressors import poses
from p2o_baselines.regressors.batch import Batch
from p2o_baselines.regressors.sweep_map import FAINTEST, FARTHEST_M, NEAREST_M


def geodesic(said: Tensor, true: Tensor, reach: Tensor) -> Tensor:
    """Return the mean distance on SE(3) of poses (B, 4, 4), angle and length in units of the reach (B, 2) rad, m.

    Left-invariant: moving both poses by one transform from the left changes nothing.
    """
    off = poses.inverse(true) @ said
    angle, length = poses.angle_of(off[:, :3, :3]), (off[:, :3, 3].square().sum(-1) + 1e-12).sqrt()
    return ((angle / reach[:, 0]).square() + (length / reach[:, 1]).square() + 1e-12).sqrt().mean()


def angle(said: Tensor, true: Tensor, reach: Tensor) -> Tensor:
    """Return the mean angle between rotations of poses (B, 4, 4) in units of the reach."""
    off = said[:, :3, :3].transpose(-1, -2) @ true[:, :3, :3]
    return (poses.angle_of(off) / reach[:, 0]).mean()


def shift(said: Tensor, true: Tensor, reach: Tensor) -> Tensor:
    """Return the smooth L1 distance of the shifts of poses (B, 4, 4) in units of the reach."""
    unit = reach[:, 1:]
    return F.smooth_l1_loss(said[:, :3, 3] / unit, true[:, :3, 3] / unit)


def dual_quaternion(raw: Tensor, batch: Batch, said: Tensor) -> Tensor:
    """Return the squared distance of dual quaternions, both parts in units of the reach."""
    found, true = poses.dual_quaternion_of(said), poses.dual_quaternion_of(batch.correction)
    real = (2 * (found - true)[:, :4] / batch.reach[:, :1]).square().sum(1)
    dual = (2 * (found - true)[:, 4:] / batch.reach[:, 1:]).square().sum(1)
    return (real + dual).mean()


def points(said: Tensor, batch: Batch) -> Tensor:
    """Return the mean distance of points after what is said and after the true correction, as a share of their depth.

    Each point is compared with itself; the depth is at least 5 m, and the unit is the angle of the stage.
    """
    found, true = poses.apply(said, batch.xyz), poses.apply(batch.correction, batch.xyz)
    off = ((found - true).square().sum(-1) + 1e-12).sqrt()
    depth: Tensor = true.norm(dim=-1).clamp_min(5.0)
    return ((off / depth).mean(1) / batch.reach[:, 0]).mean()


def chamfer(said: Tensor, batch: Batch, most: int = 128) -> Tensor:
    """Return the mean distance of each point to the nearest of the other cloud, both ways, in units as `points`.

    At most `most` points of each cloud.
    """
    found, true = (poses.apply(pose, batch.xyz[:, :most]) for pose in (said, batch.correction))
    off = (torch.cdist(found, true, compute_mode="donot_use_mm_for_euclid_dist").square() + 1e-12).sqrt()
    depth: Tensor = true.norm(dim=-1).clamp_min(5.0)
    there, back = off.min(2).values / depth, off.min(1).values / depth
    return ((0.5 * (there + back)).mean(1) / batch.reach[:, 0]).mean()


def photometric(said: Tensor, batch: Batch) -> Tensor:
    """Return how far points, moved as is said, are from the map of the true sweep where they fall, in nearness.

    The map is read bilinearly where its cells are known; gradients come through where it is read (CalibNet's 3D
    spatial transformer, the other way round: points look up the map, and are not drawn onto one).
    """
    xyz = poses.apply(said, batch.xyz)
    depth = xyz[..., 2].clamp_min(0.5)
    uv = xyz[..., :2] / depth[..., None] * batch.intrinsics[:, None, :2] + batch.intrinsics[:, None, 2:]
    height, width = batch.true_nearness.shape[1:]
    at = 2 * uv / uv.new_tensor([width - 1, height - 1]) - 1
    known = (batch.true_nearness > 0).to(uv.dtype)
    maps = torch.stack([batch.true_nearness, known], dim=1)
    near, share = F.grid_sample(maps, at[:, None].clamp(-2, 2), align_corners=True)[:, :, 0].unbind(1)
    along = (depth / NEAREST_M).clamp_min(1.0).log() / torch.log(depth.new_tensor(FARTHEST_M / NEAREST_M))
    found = (1 - (1 - FAINTEST) * along).clamp_min(FAINTEST)
    seen = (share > 0.5).to(uv.dtype)
    off = seen * (found - near / share.clamp_min(1e-3)).square()
    return off.sum() / seen.sum().clamp_min(1.0) * 10


def same_rig(said: Tensor, batch: Batch) -> Tensor:
    """Return how far neighbours in a window are from one extrinsic, and from one that fits the sensors' motions.

    Neighbours share the rig and the error of the start, so their corrections are the same; where both motions are
    known, the camera's motion A and the LiDAR's B satisfy A X = X B (pose consistency).
    """
    if batch.window < 2:
        return said.sum() * 0.0
    count = batch.window
    groups = said.reshape(-1, count, 4, 4)
    reach = batch.reach.reshape(-1, count, 2)[:, 1:].reshape(-1, 2)
    loss = geodesic(groups[:, 1:].reshape(-1, 4, 4), groups[:, :-1].reshape(-1, 4, 4), reach)
    known = torch.isfinite(batch.hand_eye).all(dim=(1, 2, 3)) if batch.hand_eye.numel() else None
    if known is None or not bool(known.any()):
        return loss
    extrinsic = (said @ batch.start)[known]
    camera, lidar = batch.hand_eye[known].unbind(1)
    return loss + geodesic(camera @ extrinsic, extrinsic @ lidar, batch.reach[known])


def matching(picture: Tensor, sweep: Tensor, size: tuple[int, int], batch: Batch) -> Tensor:
    """Return how hard it is to tell by features where a point of the sweep belongs in the picture (cross entropy).

    Features of the sweep (B, F, h, w) where points are drawn at the start, those of the picture where they belong;
    among the places of all points of a frame, the own one is to be the most alike. Places nearer than a cell are
    neither right nor wrong. `size` is that of the maps that the network sees.
    """
    true = poses.apply(batch.correction, batch.xyz)
    here, there = (_cells(xyz, batch.intrinsics, size) for xyz in (batch.xyz, true))
    inside = ((here.abs() < 1).all(-1) & (there.abs() < 1).all(-1) & (batch.xyz[..., 2] > 0.5)).to(sweep.dtype)
    a = F.normalize(F.grid_sample(sweep, here[:, :, None], align_corners=False)[..., 0], dim=1)
    b = F.normalize(F.grid_sample(picture, there[:, :, None], align_corners=False)[..., 0], dim=1)
    alike = 10.0 * a.transpose(1, 2) @ b
    apart = ((there[:, :, None] - there[:, None]) * there.new_tensor(picture.shape[:1:-1]) / 2).norm(dim=-1)
    own = torch.eye(apart.shape[1], dtype=torch.bool, device=apart.device)
    out = ((apart < 1.0) & ~own) | (inside[:, None] == 0)
    alike = alike.masked_fill(out & ~own, -30.0)
    target = torch.arange(apart.shape[1], device=apart.device).expand(len(apart), -1)
    wrong = F.cross_entropy(alike.transpose(1, 2), target, reduction="none")
    return (inside * wrong).sum() / inside.sum().clamp_min(1.0)


def _cells(xyz: Tensor, intrinsics: Tensor, size: tuple[int, int]) -> Tensor:
    """Return where points (B, P, 3) fall, -1..1 from border to border of maps of `size` (h, w)."""
    uv = xyz[..., :2] / xyz[..., 2:].clamp_min(0.5) * intrinsics[:, None, :2] + intrinsics[:, None, 2:]
    return (uv + 0.5) * 2 / uv.new_tensor([size[1], size[0]]) - 1
