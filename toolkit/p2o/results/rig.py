"""What comes out for a whole rig: one place of the LiDAR on the body, from all cameras that are fixed to it."""

from __future__ import annotations

from dataclasses import dataclass

from p2o.arrays import Float
from p2o.results.accuracy import Accuracy
from p2o.results.verdict import Verdict


@dataclass(frozen=True, eq=False)
class RigCamera:
    """One camera of a rig beside the common result.

    `camera_from_lidar` (4, 4) follows from the common result, None where there is none. The camera's own result is
    `rotation_deg` and `translation_m` away from what the other cameras say together, and `chi_square` is that step by
    the deviations of both, of six degrees of freedom; all None for a camera without a pose of its own. `left_out` says
    why a camera does not count, empty where it does.
    """

    name: str
    camera_from_lidar: Float | None = None
    rotation_deg: float | None = None
    translation_m: float | None = None
    chi_square: float | None = None
    left_out: str = ""


@dataclass(frozen=True, eq=False)
class RigResult:
    """The common result of the cameras of a rig, whose places on a body are known and fixed.

    `body_from_lidar` (4, 4) is None where fewer than two cameras count; `reason` says so. `covariance` (6, 6) is that
    of a left update in the body frame (rad, m), `accuracy` how wrong the pose is likely to be, both widened where
    cameras differ more than they should. `chi_square`, of `degrees` degrees of freedom, is how far cameras are apart by
    their likely errors, and `p_value` how likely that is by chance. `verdict` says whether all this may be trusted.
    """

    body_from_lidar: Float | None
    reason: str
    verdict: Verdict
    cameras: tuple[RigCamera, ...]
    covariance: Float | None = None
    accuracy: Accuracy | None = None
    chi_square: float | None = None
    degrees: int = 0
    p_value: float | None = None

    def reaches(self, rotation_deg: float, translation_m: float) -> bool:
        """Return whether the result is likely to be this good, and trusted."""
        good = self.accuracy is not None and self.accuracy.reaches(rotation_deg, translation_m)
        return good and self.verdict.trusted
