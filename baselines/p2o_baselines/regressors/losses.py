"""Losses of regressed poses, each the mean over a batch."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from p2o_baselines.regressors import poses
from p2o_baselines.regressors.batch import Batch
from p2o_baselines.regressors.network_input import FAINTEST, FARTHEST_M, NEAREST_M


def geodesic(predicted: Tensor, true: Tensor, reach: Tensor) -> Tensor:
    """Return the mean left-invariant distance on SE(3) of poses (B, 4, 4) in units of the reach (B, 2) rad, m."""
    off = poses.inverse(true) @ predicted
    angle, length = poses.angle_of(off[:, :3, :3]), (off[:, :3, 3].square().sum(-1) + 1e-12).sqrt()
    return ((angle / reach[:, 0]).square() + (length / reach[:, 1]).square() + 1e-12).sqrt().mean()


def angle(predicted: Tensor, true: Tensor, reach: Tensor) -> Tensor:
    """Return the mean angle between rotations of poses (B, 4, 4) in units of the reach."""
    off = predicted[:, :3, :3].transpose(-1, -2) @ true[:, :3, :3]
    return (poses.angle_of(off) / reach[:, 0]).mean()


def shift(predicted: Tensor, true: Tensor, reach: Tensor) -> Tensor:
    """Return the smooth L1 distance of the shifts of poses (B, 4, 4) in units of the reach."""
    unit = reach[:, 1:]
    return F.smooth_l1_loss(predicted[:, :3, 3] / unit, true[:, :3, 3] / unit)


def calibnet(raw: Tensor, predicted: Tensor, batch: Batch) -> Tensor:
    """Return the photometric loss of depth, Chamfer distance, and the distance of points."""
    return photometric(predicted, batch) + chamfer(predicted, batch) + points(predicted, batch)


def calibrcnn(raw: Tensor, predicted: Tensor, batch: Batch) -> Tensor:
    """Return the loss of the correction, and half of that of neighbours that share a rig and move together."""
    return pose(predicted, batch) + 0.5 * same_rig(predicted, batch)


def lccnet(raw: Tensor, predicted: Tensor, batch: Batch) -> Tensor:
    """Return smooth L1 of the shift, the angle of the quaternions, and half of the distance of points."""
    return pose(predicted, batch) + 0.5 * points(predicted, batch)


def rggnet(raw: Tensor, predicted: Tensor, batch: Batch) -> Tensor:
    """Return the distance on SE(3)."""
    return geodesic(predicted, batch.correction, batch.reach)


def pose(predicted: Tensor, batch: Batch) -> Tensor:
    """Return the loss of the correction: smooth L1 of the translation plus the angle of the rotation."""
    return shift(predicted, batch.correction, batch.reach) + angle(predicted, batch.correction, batch.reach)


def regnet(raw: Tensor, predicted: Tensor, batch: Batch) -> Tensor:
    """Return the squared distance of dual quaternions, both parts in units of the reach."""
    estimate, true = poses.dual_quaternion_of(predicted), poses.dual_quaternion_of(batch.correction)
    real = (2 * (estimate - true)[:, :4] / batch.reach[:, :1]).square().sum(1)
    dual = (2 * (estimate - true)[:, 4:] / batch.reach[:, 1:]).square().sum(1)
    return (real + dual).mean()


def points(predicted: Tensor, batch: Batch) -> Tensor:
    """Return the mean distance of points under both corrections over depth (5 m at least), in units of the angle."""
    estimate, true = poses.apply(predicted, batch.xyz), poses.apply(batch.correction, batch.xyz)
    off = ((estimate - true).square().sum(-1) + 1e-12).sqrt()
    depth: Tensor = true.norm(dim=-1).clamp_min(5.0)
    return ((off / depth).mean(1) / batch.reach[:, 0]).mean()


def chamfer(predicted: Tensor, batch: Batch, most: int = 128) -> Tensor:
    """Return the mean distance of nearest points of both clouds, both ways, `most` of each, as in `points`."""
    estimate, true = (poses.apply(pose, batch.xyz[:, :most]) for pose in (predicted, batch.correction))
    off = (torch.cdist(estimate, true, compute_mode="donot_use_mm_for_euclid_dist").square() + 1e-12).sqrt()
    depth: Tensor = true.norm(dim=-1).clamp_min(5.0)
    forward, backward = off.min(2).values / depth, off.min(1).values / depth
    return ((0.5 * (forward + backward)).mean(1) / batch.reach[:, 0]).mean()


def photometric(predicted: Tensor, batch: Batch) -> Tensor:
    """Return the squared difference in nearness between corrected points and the map of the true sweep there."""
    xyz = poses.apply(predicted, batch.xyz)
    depth = xyz[..., 2].clamp_min(0.5)
    uv = xyz[..., :2] / depth[..., None] * batch.intrinsics[:, None, :2] + batch.intrinsics[:, None, 2:]
    height, width = batch.true_nearness.shape[1:]
    at = 2 * uv / uv.new_tensor([width - 1, height - 1]) - 1
    known = (batch.true_nearness > 0).to(uv.dtype)
    maps = torch.stack([batch.true_nearness, known], dim=1)
    near, share = F.grid_sample(maps, at[:, None].clamp(-2, 2), align_corners=True)[:, :, 0].unbind(1)
    along = (depth / NEAREST_M).clamp_min(1.0).log() / torch.log(depth.new_tensor(FARTHEST_M / NEAREST_M))
    nearness = (1 - (1 - FAINTEST) * along).clamp_min(FAINTEST)
    seen = (share > 0.5).to(uv.dtype)
    off = seen * (nearness - near / share.clamp_min(1e-3)).square()
    return off.sum() / seen.sum().clamp_min(1.0) * 10


def same_rig(predicted: Tensor, batch: Batch) -> Tensor:
    """Return the inconsistency of consecutive samples with one extrinsic X, and with known motions: A X = X B."""
    if batch.window < 2:
        return predicted.sum() * 0.0
    count = batch.window
    groups = predicted.reshape(-1, count, 4, 4)
    reach = batch.reach.reshape(-1, count, 2)[:, 1:].reshape(-1, 2)
    loss = geodesic(groups[:, 1:].reshape(-1, 4, 4), groups[:, :-1].reshape(-1, 4, 4), reach)
    known = torch.isfinite(batch.hand_eye).all(dim=(1, 2, 3)) if batch.hand_eye.numel() else None
    if known is None or not bool(known.any()):
        return loss
    extrinsic = (predicted @ batch.start)[known]
    camera, lidar = batch.hand_eye[known].unbind(1)
    return loss + geodesic(camera @ extrinsic, extrinsic @ lidar, batch.reach[known])


def matching(image: Tensor, sweep: Tensor, size: tuple[int, int], batch: Batch) -> Tensor:
    """Return the cross entropy of matching a point of the sweep with its true position in the image by features.

    Features of the sweep (B, F, h, w) are sampled where points are projected at the initial extrinsic, those of the
    image at the true positions; among the positions of all points of a frame, the own one should be the most similar.
    Positions nearer than a cell are ignored. `size` is that of the input maps of the network.
    """
    true = poses.apply(batch.correction, batch.xyz)
    at_start, at_truth = (_cells(xyz, batch.intrinsics, size) for xyz in (batch.xyz, true))
    inside = ((at_start.abs() < 1).all(-1) & (at_truth.abs() < 1).all(-1) & (batch.xyz[..., 2] > 0.5)).to(sweep.dtype)
    a = F.normalize(F.grid_sample(sweep, at_start[:, :, None], align_corners=False)[..., 0], dim=1)
    b = F.normalize(F.grid_sample(image, at_truth[:, :, None], align_corners=False)[..., 0], dim=1)
    similarity = 10.0 * a.transpose(1, 2) @ b
    apart = ((at_truth[:, :, None] - at_truth[:, None]) * at_truth.new_tensor(image.shape[:1:-1]) / 2).norm(dim=-1)
    own = torch.eye(apart.shape[1], dtype=torch.bool, device=apart.device)
    out = ((apart < 1.0) & ~own) | (inside[:, None] == 0)
    similarity = similarity.masked_fill(out & ~own, -30.0)
    target = torch.arange(apart.shape[1], device=apart.device).expand(len(apart), -1)
    wrong = F.cross_entropy(similarity.transpose(1, 2), target, reduction="none")
    return (inside * wrong).sum() / inside.sum().clamp_min(1.0)


def _cells(xyz: Tensor, intrinsics: Tensor, size: tuple[int, int]) -> Tensor:
    """Return the projections of points (B, P, 3), -1..1 from border to border of maps of `size` (h, w)."""
    uv = xyz[..., :2] / xyz[..., 2:].clamp_min(0.5) * intrinsics[:, None, :2] + intrinsics[:, None, 2:]
    return (uv + 0.5) * 2 / uv.new_tensor([size[1], size[0]]) - 1
