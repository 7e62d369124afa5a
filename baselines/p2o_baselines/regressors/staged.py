"""Use of trained networks: stage by stage from wide starts to near ones, for each frame, and the median of frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from p2o import Result, Status, se3
from p2o.arrays import Float

from p2o_baselines.regressors import decalibration
from p2o_baselines.regressors.batch import correction, pictures
from p2o_baselines.regressors.decalibration import Reach
from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.glance import Glance, glance_of
from p2o_baselines.regressors.options import RegressorOptions
from p2o_baselines.regressors.parts import PairNetwork

MOST_POINTS = 60_000
"""Points of a sweep that are drawn: half of one of KITTI, as in trainings."""
LEAST_CELLS = 50
"""Cells of a network's picture that the sweep has to reach at the start."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One network and the range of starts it is asked about."""

    network: PairNetwork
    reach: Reach


@dataclass(frozen=True, eq=False)
class StagedRegressor:
    """The whole method: `stages` from the widest, used one after the other."""

    design: Design
    size: str
    stages: Sequence[Stage]
    options: RegressorOptions
    device: torch.device

    def prepare(self, frame: object) -> Glance:
        """Return what the networks see of a frame."""
        return glance_of(frame, self.design.pictures[self.size], MOST_POINTS)  # type: ignore[arg-type]

    def solve(self, prepared: Sequence[Glance], camera_from_lidar: Float) -> Result:
        """Return the pose after all stages: the median over frames."""
        start = np.asarray(camera_from_lidar, np.float64)
        names = tuple(glance.name for glance in prepared)
        cells = [int((glance.drawn(start)[0] > 0).sum()) for glance in prepared]
        used = [glance for glance, count in zip(prepared, cells, strict=True) if count >= LEAST_CELLS]
        if not used:
            reason = (
                f"the sweep falls on {max(cells, default=0)} cells of what the network sees at the start, "
                f"{LEAST_CELLS} are needed"
            )
            return Result(names, start, start, Status.NO_FEATURES, reason)
        poses = self.poses(used, start)[-1]
        if not np.isfinite(poses).all():
            return Result(names, start, start, Status.STAGE_FAILED, "the network gave no finite correction")
        found = median(poses)
        count = len(self.stages) * self.options.rounds
        reason = f"{count} corrections of {self.design.name}"
        if len(poses) > 1:
            apart = [se3.angle_deg(se3.inverse(found) @ pose) for pose in poses]
            reason += f"; the median of {len(poses)} frames, {np.median(apart):.2f} deg from them in the median"
        left_out = [glance.name for glance in prepared if glance not in used]
        warnings = (
            (f"hardly a point falls into the picture at the start: {', '.join(left_out[:5])}",) if left_out else ()
        )
        return Result(names, start, found, Status.ROUNDS_SPENT, reason, warnings=warnings)

    def poses(self, prepared: Sequence[Glance], camera_from_lidar: Float) -> list[Float]:
        """Return the poses (F, 4, 4) of all frames at the start and after each stage."""
        poses = np.repeat(np.asarray(camera_from_lidar, np.float64)[None], len(prepared), axis=0)
        out = [poses]
        for stage in self.stages:
            for _ in range(self.options.rounds):
                corrections = self.corrections(prepared, poses, stage)
                poses = np.stack([decalibration.corrected(p, c) for p, c in zip(poses, corrections, strict=True)])
                if self.options.median == "each" and np.isfinite(poses).all():
                    poses = np.repeat(median(poses)[None], len(poses), axis=0)
                out.append(poses)
        return out

    def corrections(self, prepared: Sequence[Glance], poses: Float, stage: Stage) -> Float:
        """Return the correction (F, 4, 4) that a stage says for each frame at its pose (F, 4, 4)."""
        parts = []
        for rows in windows(prepared, self.design.window):
            sweep = np.stack([prepared[i].drawn(poses[i], self.design.channels) for i in rows])
            reach = torch.tensor([[np.radians(stage.reach[0]), stage.reach[1]]] * len(rows), device=self.device).float()
            with torch.inference_mode():
                seen = pictures([prepared[i].rgb for i in rows], self.device)
                raw = stage.network(seen, torch.from_numpy(sweep).to(self.device), reach, len(rows))
                parts.append(correction(raw.double(), reach.double(), self.design.form).cpu().numpy())
        return np.concatenate(parts)


def windows(prepared: Sequence[Glance], size: int) -> list[list[int]]:
    """Return which frames are looked at together: at most `size` that follow each other in one drive."""
    out: list[list[int]] = []
    for number, glance in enumerate(prepared):
        if out and len(out[-1]) < size and prepared[out[-1][-1]].group == glance.group:
            out[-1].append(number)
        else:
            out.append([number])
    return out


def median(poses: Float) -> Float:
    """Return the median (4, 4) of poses (F, 4, 4), component by component about the one nearest to all others."""
    if len(poses) == 1:
        return np.asarray(poses[0])
    away = [
        sum(np.radians(se3.angle_deg(se3.inverse(a) @ b)) + np.linalg.norm(a[:3, 3] - b[:3, 3]) for b in poses)
        for a in poses
    ]
    middle = poses[int(np.argmin(away))]
    off = np.array([se3.log(pose @ se3.inverse(middle)) for pose in poses])
    return np.asarray(se3.exp(np.median(off, axis=0)) @ middle)


def build(design: Design, options: RegressorOptions) -> StagedRegressor:
    """Return the method with the weights that its options name; raises InputError where they cannot be read."""
    from p2o_baselines.regressors.weights_file import device_of, read_weights, stages_of, weights_files

    device = device_of(options.device)
    read = [read_weights(path, design) for path in weights_files(options.weights, design)]
    sizes = {trained.size for _, trained in read}
    if len(sizes) > 1:
        from p2o import InputError

        raise InputError("weights of two sizes", where="weights", expected="one size", got=" and ".join(sorted(sizes)))
    stages = [Stage(network.to(device), reach) for network, _, reach in stages_of(read)]
    return StagedRegressor(design, sizes.pop(), stages[min(options.first, len(stages)) - 1 :], options, device)
