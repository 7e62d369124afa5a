"""A plugin of the tests: a tiny network that sees picture and projected sweep and says how wrong the pose is.

It learns one rig: how the sweep falls into the picture tells much. Weights: `train`, 10000 steps, on 144 frames of
synthetic:?seed=1&scenes=40&frames_per_scene=4&period_s=2&place=street&width_px=414&height_px=125&lidar=hdl-32e&
right=false. Which of four settings to keep was decided on the streets of `EXAMPLE`.
"""

from __future__ import annotations

import io
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import Float, Result, Status, UInt8, se3

WIDTH, HEIGHT = 128, 40
UNIT = np.array([0.03, 0.03, 0.03, 0.1, 0.1, 0.1])  # what the outputs of the network count in: radians and metres
EXAMPLE = "synthetic:?scenes=8&place=street&width_px=414&height_px=125&lidar=hdl-32e&right=false"


class RegressorOptions(p2o.Options):
    weights: str = p2o.field("", help="File of weights from `p2o train`; empty for those of the synthetic rig.")


class TrainingOptions(p2o.Options):
    iterations: int = p2o.field(10000, ge=1, help="Steps.")


@dataclass(frozen=True)
class Glance:
    """What the network sees of a frame: grey (40, 128) and some points (N, 3) ahead with reflectance (N,) in 0..1."""

    name: str
    camera: p2o.Camera
    grey: UInt8
    xyz: Float
    reflectance: Float

    @classmethod
    def of(cls, frame: p2o.Frame) -> Glance:
        import cv2

        grey = cv2.resize(frame.image.grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        cloud = frame.cloud.select(np.abs(frame.cloud.xyz[:, 1]) < frame.cloud.xyz[:, 0])
        cloud = cloud.select(np.random.default_rng(0).permutation(len(cloud))[:8000])  # every n-th: a pattern
        return cls(frame.name, frame.camera, grey, cloud.xyz, np.clip(cloud.intensity, 0.0, 1.0))

    def seen(self, camera_from_lidar: Float) -> UInt8:
        """Return grey, nearness and reflectance (3, 40, 128) at a pose (4, 4)."""
        xyz = se3.apply(camera_from_lidar, self.xyz)
        uv = (self.camera.project(xyz) + 0.5) * [WIDTH / self.camera.width, HEIGHT / self.camera.height]
        rows = np.flatnonzero((uv >= 0).all(axis=1) & (uv < [WIDTH, HEIGHT]).all(axis=1))
        rows = rows[np.argsort(-xyz[rows, 2])]  # the nearest is written last
        u, v = uv[rows].astype(int).T
        out = self.grey * np.array([1, 0, 0], np.uint8)[:, None, None]
        out[1, v, u] = np.clip(255 - 69 * np.log(np.maximum(xyz[rows, 2], 2.0) / 2), 5, 255)
        out[2, v, u] = 255 * self.reflectance[rows]
        return out


def network() -> Any:
    from torch import nn

    sizes = ((3, 16, 2), (16, 24, 2), (24, 32, 2), (32, 16, 1))
    blocks = [(nn.Conv2d(a, b, 5, by, padding=2), nn.GroupNorm(4, b), nn.ReLU()) for a, b, by in sizes]
    return nn.Sequential(*sum(blocks, ()), nn.Flatten(), nn.Linear(16 * 80, 32), nn.ReLU(), nn.Linear(32, 6))


def said(net: Any, seen: UInt8) -> Any:
    """Return the errors (B, 6) in `UNIT` that the network sees in pictures (B, 3, 40, 128)."""
    import torch

    grey, rest = (torch.from_numpy(seen).float() / 255).split([1, 2], dim=1)
    flat = (grey - grey.mean((2, 3), keepdim=True)) / (grey.std((2, 3), keepdim=True) + 0.01)
    return net(torch.cat([flat, rest], dim=1))


@dataclass(frozen=True)
class Regressor:
    net: Any

    def prepare(self, frame: p2o.Frame) -> Glance:
        return Glance.of(frame)

    def solve(self, prepared: list[Glance], camera_from_lidar: Float) -> Result:
        pose, reason = camera_from_lidar, "3 corrections of the network, each the median over all frames"
        for _ in range(3):
            errors = said(self.net, np.stack([glance.seen(pose) for glance in prepared])).detach().numpy()
            pose = se3.exp(np.median(errors, axis=0) * UNIT) @ pose
        return Result(tuple(g.name for g in prepared), camera_from_lidar, pose, Status.ROUNDS_SPENT, reason)


def build(options: RegressorOptions) -> Regressor:
    from safetensors.torch import load_file

    net = network()
    weights = load_file(options.weights or Path(__file__).with_name("regressor.safetensors"))
    net.load_state_dict({name: value.float() for name, value in weights.items()})
    return Regressor(net)


def label(frame: p2o.Frame) -> bytes:
    """Return how the frame looks from 64 wrong poses, and how wrong each is: up to 4 deg and 0.25 m."""
    glance, rng, file = Glance.of(frame), np.random.default_rng(len(frame.cloud)), io.BytesIO()
    ways, sizes = rng.standard_normal((64, 2, 3)), rng.random((64, 2, 1)) * [[np.radians(4)], [0.25]]
    errors = (sizes * ways / np.linalg.norm(ways, axis=2, keepdims=True)).reshape(64, 6)
    seen = [glance.seen(se3.exp(-error) @ frame.camera_from_lidar) for error in errors]
    np.savez_compressed(file, seen=np.stack(seen), errors=errors / UNIT)
    return file.getvalue()


def train(options: TrainingOptions, groups: Any, validation: Any, out: Path, report: Any) -> Path:
    import torch
    from safetensors.torch import save

    seen, errors = (np.concatenate([np.load(p)[key] for g in groups for p in g.paths]) for key in ("seen", "errors"))
    torch.manual_seed(0)
    net, rng, began = network(), np.random.default_rng(0), time.monotonic()
    optimizer = torch.optim.AdamW(net.parameters())
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 3e-3, options.iterations)
    for step in range(1, options.iterations + 1):
        rows, kept = rng.integers(len(seen), size=32), rng.random((32, 3, HEIGHT, WIDTH)) > [[[0.0]], [[0.2]], [[0.2]]]
        loss = (said(net, seen[rows] * kept) - torch.from_numpy(errors[rows]).float()).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if step % 100 == 0 or step == options.iterations:
            report(p2o.TrainingProgress(step, options.iterations, loss.item(), None, time.monotonic() - began))
    (out / "weights.safetensors").write_bytes(save({name: value.half() for name, value in net.state_dict().items()}))
    return out / "weights.safetensors"


@p2o.hookimpl
def p2o_calibrators():
    parts = {"label": label, "train": train, "draw": lambda path: np.load(path)["seen"][0].T}
    yield p2o.Method(
        name="regressor",
        build=build,
        options=RegressorOptions,
        summary="A tiny network that learned one rig.",
        needs={"intensity"},
        trainer=p2o.Trainer(options=TrainingOptions, **parts),
        example=p2o.Example(EXAMPLE, "3deg 0.2m", "1.5deg 0.1m", joint=True),
    )
