"""Apply trained networks in stages, from large initial errors to small ones, to each frame, and take the median."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from p2o import Float, InputError, Result, Status, se3

from p2o_baselines.regressors.batch import correction, image_tensor
from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.network_input import NetworkInput, network_input_of
from p2o_baselines.regressors.options import RegressorOptions
from p2o_baselines.regressors.parts import PairNetwork
from p2o_baselines.regressors.sample import Reach

_MOST_POINTS = 60_000  # of a sweep, that are projected: half of those of KITTI, as in training
_LEAST_CELLS = 50  # least number of cells of the network's input that the sweep must reach at the initial extrinsic


@dataclass(frozen=True, eq=False)
class Stage:
    """One network and its range of initial errors."""

    network: PairNetwork
    reach: Reach


@dataclass(frozen=True, eq=False)
class StagedRegressor:
    """The calibrator: `stages` from the largest range, applied in sequence."""

    design: Design
    size: str
    stages: Sequence[Stage]
    options: RegressorOptions
    device: torch.device

    def prepare(self, frame: object) -> NetworkInput:
        """Return what the networks see of a frame."""
        return network_input_of(frame, self.design.inputs[self.size], _MOST_POINTS)  # type: ignore[arg-type]

    def solve(self, prepared: Sequence[NetworkInput], camera_from_lidar: Float) -> Result:
        """Return the pose after all stages: the median over frames."""
        start = np.asarray(camera_from_lidar, np.float64)
        names = tuple(each.name for each in prepared)
        cells = [int((each.drawn(start)[0] > 0).sum()) for each in prepared]
        used = [each for each, count in zip(prepared, cells, strict=True) if count >= _LEAST_CELLS]
        if not used:
            most = f"{max(cells, default=0)} cells of the network's input at the initial extrinsic"
            reason = f"the sweep falls on {most}, {_LEAST_CELLS} are needed"
            return Result(names, start, start, Status.NO_FEATURES, reason)
        poses = self.poses(used, start)[-1]
        if not np.isfinite(poses).all():
            return Result(names, start, start, Status.STAGE_FAILED, "the correction of the network is not finite")
        solution = median(poses)
        reason = f"{len(self.stages)} corrections of {self.design.name}"
        if len(poses) > 1:
            apart = [se3.angle_deg(se3.inverse(solution) @ pose) for pose in poses]
            reason += f"; the median of {len(poses)} frames, {np.median(apart):.2f} deg from them (median)"
        left_out = ", ".join([each.name for each in prepared if each not in used][:5])
        warnings = (f"almost no point is in the image at the initial extrinsic: {left_out}",) if left_out else ()
        return Result(names, start, solution, Status.ROUNDS_SPENT, reason, warnings=warnings)

    def poses(self, prepared: Sequence[NetworkInput], camera_from_lidar: Float) -> list[Float]:
        """Return the poses (F, 4, 4) of all frames initially and after each stage."""
        poses = np.repeat(np.asarray(camera_from_lidar, np.float64)[None], len(prepared), axis=0)
        out = [poses]
        for stage in self.stages:
            corrections = self.corrections(prepared, poses, stage)
            poses = np.stack([each @ pose for each, pose in zip(corrections, poses, strict=True)])
            out.append(poses)
        return out

    def corrections(self, prepared: Sequence[NetworkInput], poses: Float, stage: Stage) -> Float:
        """Return the correction (F, 4, 4) of a stage for each frame at its pose (F, 4, 4)."""
        parts = []
        for rows in windows(prepared, self.design.window):
            sweep = np.stack([prepared[i].drawn(poses[i], self.design.channels) for i in rows])
            reach = torch.tensor([[np.radians(stage.reach[0]), stage.reach[1]]] * len(rows), device=self.device).float()
            with torch.inference_mode():
                seen = image_tensor(np.stack([prepared[i].rgb for i in rows]), self.device)
                raw = stage.network(seen, torch.from_numpy(sweep).to(self.device), reach, len(rows))
                parts.append(correction(raw.double(), reach.double(), self.design.form).cpu().numpy())
        return np.concatenate(parts)


def windows(prepared: Sequence[NetworkInput], size: int) -> list[list[int]]:
    """Return the frames that are processed together: at most `size` consecutive ones of a drive."""
    out: list[list[int]] = []
    for number, network_input in enumerate(prepared):
        if out and len(out[-1]) < size and prepared[out[-1][-1]].group == network_input.group:
            out[-1].append(number)
        else:
            out.append([number])
    return out


def median(poses: Float) -> Float:
    """Return the median (4, 4) of poses (F, 4, 4), by component relative to the one nearest to all others."""
    if len(poses) == 1:
        return np.asarray(poses[0])
    away = [
        sum(np.radians(se3.angle_deg(se3.inverse(a) @ b)) + np.linalg.norm(a[:3, 3] - b[:3, 3]) for b in poses)
        for a in poses
    ]
    middle = poses[int(np.argmin(away))]
    off = np.array([se3.log(pose @ se3.inverse(middle)) for pose in poses])
    return np.asarray(se3.exp(np.median(off, axis=0)) @ middle)


def build(design: Design, options: RegressorOptions, files: Sequence[Path]) -> StagedRegressor:
    """Return the calibrator with the weights of files; raises InputError if they cannot be read."""
    from p2o_baselines.learned.device import device_of
    from p2o_baselines.regressors.weights_file import read_weights

    device = device_of(options.device)
    read = [read_weights(path, design) for path in files]
    sizes = {trained.size for _, trained in read}
    if len(sizes) > 1:
        raise InputError("weights of two sizes", where="weights", expected="one size", got=" and ".join(sorted(sizes)))
    stages = [Stage(network.to(device), reach) for network, trained in read for reach in trained.stages]
    return StagedRegressor(design, sizes.pop(), stages[min(options.first, len(stages)) - 1 :], options, device)
