"""The pose at which data are looked at before anything is calibrated: what the data offer, a file, or the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.host.calibration_file import read_initial_guess
from p2o.host.registry import Registry
from p2o.run.initial_guess import start_of
from p2o.run.recipe import Recipe

Which = Literal["start", "truth"]


@dataclass(frozen=True, eq=False)
class GivenPose:
    """Return the pose of a frame: `which` of those that the data have, or `known` from a file or words, perturbed."""

    recipe: Recipe
    which: Which = "start"
    known: Float | None = None

    @classmethod
    def of(cls, recipe: Recipe, which: Which = "start", registry: Registry | None = None) -> GivenPose:
        """Return what a recipe says; raises InputError for a start that cannot be read, or one beside the truth."""
        option = "--start" if recipe.start is not None else "--perturb"
        if which == "truth" and (recipe.start is not None or recipe.perturb is not None):
            raise InputError("the pose is said twice", where=option, expected=f"{option} or --pose truth")
        if recipe.start is None:
            return cls(recipe, which)
        pose, _ = read_initial_guess(recipe.start, "--start", registry=registry)
        return cls(recipe, which, se3.check_rigid("start", pose))

    def of_frame(self, frame: Frame, index: int, listed: Mapping[int, Float] | None = None) -> tuple[Float, str]:
        """Return camera_from_lidar (4, 4) and what it is in a few words; InputError where the frame has none."""
        if self.which == "truth":
            if frame.camera_from_lidar is None:
                hint = "leave out --pose, or give --start FILE"
                raise InputError("the truth is not known", where=frame.name, hint=hint)
            return frame.camera_from_lidar, "the calibration that the data give"
        if all(x is None for x in (self.known, self.recipe.perturb, frame.start, frame.camera_from_lidar)):
            expected = "a start or a calibration in the data"
            hint = 'give one: --start FILE, or --start "roughly x forward, z up; camera looks forward"'
            raise InputError("there is no pose to look from", where=frame.name, expected=expected, hint=hint)
        pose, _ = start_of((frame,), frame.camera_from_lidar, self.recipe, self.known, index, listed or {})
        if self.known is not None:
            return pose, f"the pose of {self.recipe.start}"
        if self.recipe.perturb is not None:
            return pose, f"the calibration that the data give, {self.recipe.perturb} off"
        return pose, "the start of the data" if frame.start is not None else "the calibration that the data give"
