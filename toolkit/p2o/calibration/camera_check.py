"""What a calibration says about the calibration of its cameras, and when that is worth a warning."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeGuard

import numpy as np

from p2o.features.view import View
from p2o.geometry.camera import Camera
from p2o.geometry.radial_error import RadialError, RadialFit
from p2o.problems.point_to_line import PointToLine
from p2o.problems.problem import Problem
from p2o.results.result import CameraCheck
from p2o.results.verdict import Doubt, Reason

_DOUBTFUL_PX = 1.5
_DOUBTFUL_SIGMAS = 5.0
_TELLING_PAIRS = 100


def tells_more(problem: Problem | None) -> TypeGuard[PointToLine]:
    """Return whether there are pairs, and enough of them to tell more than the pose from."""
    return isinstance(problem, PointToLine) and len(problem) >= _TELLING_PAIRS


def checks_of(fits: Sequence[RadialFit], cameras: Sequence[Camera], *, corrected: bool) -> tuple[CameraCheck, ...]:
    """Return the fitted errors as a result holds them; `cameras` are those of all frames."""
    return tuple(
        CameraCheck(
            frames=cameras.count(fit.camera),
            camera=fit.camera,
            better=fit.error.corrected(fit.camera),
            focal=fit.error.focal,
            focal_sigma=float(np.sqrt(fit.covariance[0, 0])),
            radial=fit.error.radial,
            radial_sigma=float(np.sqrt(fit.covariance[1, 1])),
            shift_px=fit.error.shift_px(fit.camera),
            shift_sigma_px=fit.sigma_px,
            corrected=corrected,
        )
        for fit in fits
    )


def at_full_size(checks: Sequence[CameraCheck], views: Sequence[View]) -> tuple[CameraCheck, ...]:
    """Return checks of cameras of pictures that were looked at smaller as checks of the cameras that were given."""
    given = {view.camera: view.full_size for view in views if view.full_size is not None}
    out = []
    for check in checks:
        camera = given.get(check.camera)
        if camera is not None:
            larger = camera.focal_px / check.camera.focal_px
            check = replace(
                check,
                camera=camera,
                better=RadialError(check.focal, check.radial).corrected(camera),
                shift_px=check.shift_px * larger,
                shift_sigma_px=check.shift_sigma_px * larger,
            )
        out.append(check)
    return tuple(out)


def doubt(check: CameraCheck) -> Reason | None:
    """Return a remark where the error is large and sure, or None.

    On synthetic frames, whose cameras are right, three of 48 single ones seemed wrong by more than 1.5 px and four
    standard deviations, none by five, and 24 together by 1.1 to 1.3 px: hence the bounds.
    """
    sure = check.shift_px > _DOUBTFUL_SIGMAS * check.shift_sigma_px
    if check.corrected or check.shift_px <= _DOUBTFUL_PX or not sure:
        return None
    return Reason(
        Doubt.CAMERA,
        f"the camera's calibration is in doubt: edges are seen up to {check.shift_px:.1f} px from where it puts them "
        f"(focal length {100 * check.focal:+.2f} %, radial distortion {check.radial:+.4f}); calibrate its lens anew, "
        "or correct it here with --set pipeline.camera=refine",
    )
