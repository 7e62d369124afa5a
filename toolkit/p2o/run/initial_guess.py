"""Where a calibration begins: a given pose, a perturbation of the truth, or the initial guess of the frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.direction import check_direction
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.geometry.start_list import StartList, parse_starts
from p2o.host.calibration_file import names_file
from p2o.run.protocol import protocol_of
from p2o.run.read_again import FrameInfo
from p2o.run.recipe import Plan, Recipe


def starts_of(protocol: str | None, perturb: str | None, where: str = "protocol") -> str | None:
    """Return the perturbation that is requested directly or by a protocol.

    Beside a protocol a published list of starts may be asked for; InputError for any other, and for a list whose
    errors act in another frame than the protocol's.
    """
    if protocol is None:
        return perturb
    drawn = protocol_of(protocol, where).perturb
    if perturb is None:
        return drawn
    listed = parse_starts(perturb)
    if not isinstance(listed, StartList):
        expected = "no perturbation beside it but @FILE"
        raise InputError("a protocol draws its own starts", where=where, expected=expected, got=perturb)
    wanted = replace(listed, in_camera=parse_starts(drawn).in_camera)
    if listed != wanted:
        text = f"errors of protocol {protocol} act in the {'camera' if wanted.in_camera else 'LiDAR'}'s frame"
        raise InputError(text, where=where, expected=f'"{wanted}"', got=perturb)
    return perturb


def given_guess(plan: Plan, start: Float | None) -> tuple[Float | None, tuple[str, ...]]:
    """Return the initial extrinsic (4, 4) given as a pose or in words, or None, and remarks on it."""
    recipe, remarks = plan.recipe, tuple[str, ...]()
    if plan.initial_guess is not None:
        if start is not None:
            raise InputError("a start is given twice, as a pose and in words", expected="one of them")
        start, remarks, _ = plan.initial_guess
    if start is None:
        return None, remarks
    if plan.rig is not None:
        hint = "give body_from_lidar in the rig file, or the start in each frame"
        raise InputError("a start is of one camera, and a rig has several", expected="no start beside a rig", hint=hint)
    if recipe.perturb is not None:
        raise InputError("both a start and a perturbation are given", expected="one of them")
    return se3.check_rigid("start", start), remarks


def listed_errors(recipe: Recipe, names: Sequence[str], indices: Sequence[int]) -> dict[int, Float]:
    """Return the errors (4, 4) that a list gives the frames `indices` of a dataset, by index; none without a list.

    Raises InputError for a list that is missing, cannot be read or has no line for one of them.
    """
    starts = None if recipe.perturb is None else parse_starts(recipe.perturb)
    return starts.errors(names, indices) if isinstance(starts, StartList) else {}


def start_of(
    frames: Sequence[Frame] | Sequence[FrameInfo],
    truth: Float | None,
    recipe: Recipe,
    start: Float | None,
    index: int,
    listed: Mapping[int, Float],
    *,
    quaternion: bool = False,
) -> tuple[Float, tuple[str, ...]]:
    """Return the initial guess and remarks on it; `listed` are the `listed_errors` by index.

    `quaternion` states whether the rotation of `start` was given as a quaternion, whose order may be wrong.
    """
    if start is not None:
        if recipe.start is None or not names_file(recipe.start):
            return start, ()
        # Files of other tools often contain the inverse transform.
        frame = frames[0]
        assert frame.cloud is not None  # that of the first frame is kept
        given: dict[str, Any] = {"where": recipe.start, "quaternion": quaternion}
        return start, check_direction(frame.cloud, frame.camera, start, name="the start", **given)
    if recipe.perturb is not None:
        if truth is None:
            hint = "leave out --perturb to begin at the start that the data give"
            raise InputError("the truth is not known, so it cannot be perturbed", where=frames[0].name, hint=hint)
        size = parse_starts(recipe.perturb)
        if isinstance(size, StartList):
            return size.start(truth, listed[index]), ()
        # Seeded by the number of the (first) frame in the data: the guess does not depend on the other frames of the
        # run, and a joint calibration has the one of the same group of frames in a study.
        rng = np.random.default_rng([recipe.seed, index])
        return size.start(truth, rng, recipe.seed), ()
    offered = common_pose(frames, "start")
    if offered is not None:
        return offered, ()
    if truth is not None:
        return truth, ("the start is the calibration that the data give: this checks it (see --perturb)",)
    expected = "a start pose camera_from_lidar in the data"
    hint = 'give one: --start FILE, or --start "roughly x forward, z up; camera looks forward"; start= in Python'
    raise InputError("there is no start to calibrate from", where=frames[0].name, expected=expected, hint=hint)


def one_camera(frames: Sequence[Frame] | Sequence[FrameInfo]) -> str:
    """Return the name of the camera of all frames, empty if they name none; raises InputError for several."""
    named = sorted({frame.camera_name for frame in frames})
    if len(named) > 1:
        text = f"frames of {len(named)} cameras have no pose in common"
        got = ", ".join(name or "none named" for name in named)
        hint = "calibrate each camera of the rig with --rig, or choose frames of one"
        raise InputError(text, where="--joint", expected="frames of one camera", got=got, hint=hint)
    return named[0]


_SAME_DEG, _SAME_M = 1e-3, 1e-4


def common_pose(frames: Sequence[Frame] | Sequence[FrameInfo], name: str) -> Float | None:
    """Return the one pose `name` of all frames that know it, or None; raises InputError if two differ.

    Files round the pose of each frame separately: poses that no calibration can distinguish count as one.
    """
    known = [frame for frame in frames if getattr(frame, name) is not None]
    for frame in known[1:]:
        step = se3.inverse(getattr(known[0], name)) @ getattr(frame, name)
        if se3.angle_deg(step) > _SAME_DEG or se3.distance_m(step) > _SAME_M:
            label = "extrinsics" if name == "camera_from_lidar" else "starts"
            text = f"frames {known[0].name} and {frame.name} have different {label}"
            got = f"{se3.angle_deg(step):.3g} deg and {se3.distance_m(step):.3g} m apart"
            hint = "calibrate them apart, without --joint, or each camera of a rig with --rig"
            raise InputError(text, expected="one rig for --joint", got=got, hint=hint)
    return getattr(known[0], name) if known else None
