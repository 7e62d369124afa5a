"""How wrong a calibration is likely to be: an answer to "is my result good?" in degrees and metres."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Accuracy:
    """How wrong a calibration is likely to be, from what is known without any truth.

    Two of three calibrations with such numbers are off by less than `rotation_deg`, and two of three by less than
    `translation_m`; nineteen of twenty by less than `rotation_deg_95` and by less than `translation_m_95`. Errors are
    those of `p2o.geometry.pose_error.pose_error`. `roll_deg` to `z_m` are the bounds for two of three by camera axis
    (roll about z, pitch about x, yaw about y, as errors have them), None where nobody tells them apart: a direction
    that the scene does not determine widens its own axis only.
    """

    rotation_deg: float
    translation_m: float
    rotation_deg_95: float
    translation_m_95: float
    roll_deg: float | None = None
    pitch_deg: float | None = None
    yaw_deg: float | None = None
    x_m: float | None = None
    y_m: float | None = None
    z_m: float | None = None

    def reaches(self, rotation_deg: float, translation_m: float) -> bool:
        """Return whether two of three such calibrations are at least as good as this."""
        return self.rotation_deg <= rotation_deg and self.translation_m <= translation_m
