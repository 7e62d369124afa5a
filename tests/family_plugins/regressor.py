"""A plugin of the tests: a tiny network that sees picture and projected sweep and says how wrong the pose is.

After RegNet (Schneider et al., 2017). It learns one rig and knows that one only: much of what it says it reads from
how the sweep falls into the picture, whatever the picture shows. `p2o train regressor` makes its weights; those beside
this file are of the rig of the dataset `synthetic`, by the command that `EXAMPLE` names.
"""

from __future__ import annotations

import io
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import p2o
from p2o import Result, Status, se3
from p2o.arrays import Float, UInt8
from p2o.files.whole_file import write_whole

WIDTH, HEIGHT = 128, 40
UNIT = np.array([0.05, 0.05, 0.05, 0.2, 0.2, 0.2])
"""What the six outputs of the network count in: radians and metres."""


class RegressorOptions(p2o.Options):
    """How it is used."""

    weights: str = p2o.field("", help="File of weights from `p2o train`; empty for those of the synthetic rig.")
    rounds: int = p2o.field(3, ge=1, help="How often the network corrects the pose.")


class TrainingOptions(p2o.Options):
    """How it learns."""

    iterations: int = p2o.field(3000, ge=1, help="Steps.")
    batch: int = p2o.field(32, ge=1, help="Wrong poses a step.")
    angle_deg: float = p2o.field(4.0, gt=0, help="Largest turn of a wrong pose.")
    shift_m: float = p2o.field(0.25, gt=0, help="Largest shift of a wrong pose.")
    learning_rate: float = p2o.field(2e-3, gt=0, help="Largest rate, which falls to zero.")
    seed: int = p2o.field(0, ge=0, help="Seed of weights and wrong poses.")


@dataclass(frozen=True)
class Glance:
    """What the network sees of a frame: grey (40, 128) and some thousand points (N, 3) ahead with reflectance (N,)."""

    name: str
    camera: p2o.Camera
    grey: UInt8
    xyz: Float
    reflectance: Float

    @classmethod
    def of(cls, frame: p2o.Frame) -> Glance:
        """Return the glance at a frame."""
        import cv2

        grey = cv2.resize(frame.image.grey, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA)
        xyz, given = frame.cloud.xyz, frame.cloud.intensity
        ahead = np.flatnonzero((xyz[:, 0] > 1.0) & (np.abs(xyz[:, 1]) < 1.2 * xyz[:, 0] + 1.0))
        kept = np.random.default_rng(0).permutation(ahead)[:8000]  # every n-th would draw a pattern to go by
        reflectance = np.zeros(len(kept)) if given is None else given[kept]
        return cls(frame.name, frame.camera, grey, xyz[kept], reflectance)

    def seen(self, camera_from_lidar: Float) -> Any:
        """Return grey, inverse depth and reflectance (3, 40, 128) at a pose (4, 4), float32."""
        xyz = se3.apply(camera_from_lidar, self.xyz)
        scale = np.array([WIDTH / self.camera.width, HEIGHT / self.camera.height])
        with np.errstate(invalid="ignore"):
            u, v = np.floor((self.camera.project(xyz) + 0.5) * scale).T
            order = np.flatnonzero((u >= 0) & (u < WIDTH) & (v >= 0) & (v < HEIGHT))
        order = order[np.argsort(-xyz[order, 2])]  # the nearest is written last
        out, at = np.zeros((3, HEIGHT, WIDTH), np.float32), (v[order].astype(int), u[order].astype(int))
        out[0] = (self.grey - self.grey.mean()) / (self.grey.std() + 1.0)
        out[1][at], out[2][at] = 5.0 / xyz[order, 2], self.reflectance[order]
        return out


def network() -> Any:
    """Return the network: pictures (B, 3, 40, 128) to errors (B, 6) in `UNIT`."""
    from torch import nn

    def layer(given: int, made: int, stride: int) -> list[Any]:
        return [nn.Conv2d(given, made, 3, stride, 1), nn.BatchNorm2d(made), nn.ReLU()]

    body = [*layer(3, 16, 1), *layer(16, 24, 2), *layer(24, 32, 2), *layer(32, 32, 2), *layer(32, 12, 1)]
    return nn.Sequential(*body, nn.Flatten(), nn.Linear(12 * 80, 64), nn.ReLU(), nn.Linear(64, 6))


@dataclass(frozen=True)
class Regressor:
    """The whole method."""

    net: Any
    rounds: int

    def prepare(self, frame: p2o.Frame) -> Glance:
        """Return what the network sees, before the sweep is projected."""
        return Glance.of(frame)

    def solve(self, prepared: Sequence[Glance], camera_from_lidar: Float) -> Result:
        """Return the start after some corrections, each the median over all frames."""
        import torch

        pose = camera_from_lidar
        for _ in range(self.rounds):
            with torch.inference_mode():
                said = self.net(torch.from_numpy(np.stack([glance.seen(pose) for glance in prepared]))).numpy()
            pose = se3.exp(np.median(said, axis=0) * UNIT) @ pose
        names = tuple(glance.name for glance in prepared)
        return Result(names, camera_from_lidar, pose, Status.ROUNDS_SPENT, f"{self.rounds} corrections of the network")


def build(options: RegressorOptions) -> Regressor:
    """Return the method with its weights; loading them executes nothing."""
    from safetensors.torch import load_file

    net = network()
    path = options.weights or Path(__file__).with_name("regressor.safetensors")
    net.load_state_dict({name: value.float() for name, value in load_file(path).items()}, strict=False)
    return Regressor(net.eval(), options.rounds)


def label(frame: p2o.Frame) -> bytes:
    """Return the glance at a frame and the truth."""
    glance, file = Glance.of(frame), io.BytesIO()
    camera = glance.camera
    size = np.array([camera.width, camera.height])
    np.savez(
        file,
        model=camera.model,
        size=size,
        params=camera.params,
        grey=glance.grey,
        truth=frame.camera_from_lidar,
        xyz=glance.xyz.astype(np.float32),
        reflectance=glance.reflectance.astype(np.float32),
    )
    return file.getvalue()


def read(path: Path) -> tuple[Glance, Float]:
    """Return glance and truth of a label file."""
    with np.load(path, allow_pickle=False) as kept:
        camera = p2o.Camera(str(kept["model"]), *map(int, kept["size"]), tuple(map(float, kept["params"])))
        points = (kept[name].astype(np.float64) for name in ("xyz", "reflectance"))
        return Glance(path.stem, camera, kept["grey"], *points), kept["truth"]


def train(options: TrainingOptions, groups: Any, validation: Any, out: Path, report: Any) -> Path:
    """Learn from all label files alike."""
    import torch
    from safetensors.torch import save

    weights = out / "weights.safetensors"
    bank = [read(path) for group in groups for path in group.paths]
    held = [read(path) for path in validation]
    torch.manual_seed(options.seed)
    net, began = network(), time.monotonic()
    optimizer = torch.optim.AdamW(net.parameters(), options.learning_rate, weight_decay=0.01)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, options.learning_rate, options.iterations + 1)

    def batch(frames: Any, rng: np.random.Generator) -> Any:
        seen, wanted = [], []
        for number in rng.integers(len(frames), size=options.batch):
            glance, truth = frames[number]
            way = rng.standard_normal((2, 3))
            way *= (rng.random((2, 1)) * [[np.radians(options.angle_deg)], [options.shift_m]]) / np.linalg.norm(
                way, axis=1, keepdims=True
            )
            maps = glance.seen(se3.exp(-way.ravel()) @ truth)
            maps[0] = maps[0] * rng.uniform(0.7, 1.4) + rng.normal(0, 0.2) + rng.normal(0, 0.1, maps[0].shape)
            seen.append(maps)
            wanted.append(way.ravel() / UNIT)
        return torch.from_numpy(np.stack(seen)), torch.from_numpy(np.array(wanted, np.float32))

    for step in range(options.iterations):
        seen, wanted = batch(bank, np.random.default_rng([options.seed, step]))
        loss = (net(seen) - wanted).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if (step + 1) % 100 == 0 or step + 1 == options.iterations:
            with torch.inference_mode():
                net.eval()
                errors = (
                    [net(a).sub(b).abs().mean(0) for a, b in (batch(held, np.random.default_rng(i)) for i in range(8))]
                    if held
                    else []
                )
                net.train()
            if held:
                print((torch.stack(errors).mean(0).numpy() * UNIT * [57.3, 57.3, 57.3, 1, 1, 1]).round(3))
            found = float(torch.stack(errors).mean()) if held else None
            report(p2o.TrainingProgress(step + 1, options.iterations, float(loss), found, time.monotonic() - began))
    write_whole(
        weights, save({name: value.half() for name, value in net.state_dict().items() if value.is_floating_point()})
    )
    return weights


def draw(path: Path) -> Any:
    """Return grey, inverse depth and reflectance at the true pose below one another."""
    glance, truth = read(path)
    maps = glance.seen(truth)
    rows = np.concatenate([(maps[0] + 2) / 4, np.minimum(maps[1], 1), maps[2]])
    return np.repeat(np.clip(255 * rows, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


@p2o.hookimpl
def p2o_calibrators():
    """Offer the method."""
    rig = "place=street&width_px=414&height_px=125&lidar=hdl-32e&right=false"
    yield p2o.Method(
        name="regressor",
        build=build,
        options=RegressorOptions,
        summary="A tiny network that learned one rig.",
        needs={"intensity"},
        cite="Schneider et al., RegNet: multimodal sensor registration using deep neural networks, 2017",
        trainer=p2o.Trainer(options=TrainingOptions, label=label, draw=draw, train=train),
        example=p2o.Example(f"synthetic:?scenes=8&{rig}", "3deg 0.2m", "1.5deg 0.1m", joint=True),
    )
