"""The pose at which data are looked at before anything is calibrated: what the data offer, a file, or the truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from p2o.arrays import Float
from p2o.errors import InputError
from p2o.formats.files import start_words
from p2o.frames.frame import Frame
from p2o.geometry import se3
from p2o.run.recipe import Recipe
from p2o.run.run import start_of

Which = Literal["start", "truth"]


@dataclass(frozen=True, eq=False)
class GivenPose:
    """Says the pose of a frame: `which` of those that the data have, the one `told` by a file or in words, perturbed
    or not. `listed` are the errors of a list of starts by index.
    """

    recipe: Recipe
    which: Which = "start"
    told: Float | None = None

    @classmethod
    def of(cls, recipe: Recipe, which: Which = "start") -> GivenPose:
        """Return what a recipe says; raises InputError for a start that cannot be read, or one beside the truth."""
        said = "--start" if recipe.start is not None else "--perturb"
        if which == "truth" and (recipe.start is not None or recipe.perturb is not None):
            raise InputError("the pose is said twice", where=said, expected=f"{said} or --pose truth")
        if recipe.start is None:
            return cls(recipe, which)
        pose, _ = start_words(recipe.start, "--start")
        return cls(recipe, which, se3.check_rigid("start", pose))

    def of_frame(self, frame: Frame, index: int, listed: Mapping[int, Float] | None = None) -> tuple[Float, str]:
        """Return camera_from_lidar (4, 4) and what it is in a few words; InputError where the frame has none."""
        if self.which == "truth":
            if frame.camera_from_lidar is None:
                raise InputError(
                    "the truth is not known", where=frame.name, hint="leave out --pose, or give --start FILE"
                )
            return frame.camera_from_lidar, "the calibration that the data give"
        if (
            self.told is None
            and self.recipe.perturb is None
            and frame.start is None
            and frame.camera_from_lidar is None
        ):
            raise InputError(
                "there is no pose to look from",
                where=frame.name,
                expected="a start or a calibration in the data",
                hint='give one: --start FILE, or --start "roughly x forward, z up; camera looks forward"',
            )
        pose, _ = start_of((frame,), frame.camera_from_lidar, self.recipe, self.told, index, listed or {})
        if self.told is not None:
            return pose, f"the pose of {self.recipe.start}"
        if self.recipe.perturb is not None:
            return pose, f"the calibration that the data give, {self.recipe.perturb} off"
        return pose, "the start of the data" if frame.start is not None else "the calibration that the data give"
