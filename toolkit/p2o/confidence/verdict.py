"""The verdict on a pose, from agreement of edges, rival pose, predicted error and calibration of the camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from p2o.calibration.intrinsics import IntrinsicFit
from p2o.calibration.nuisance import NuisanceEstimate
from p2o.calibration.options import PipelineOptions
from p2o.calibration.rounds import End
from p2o.calibration.search_box import SearchBox
from p2o.confidence.accuracy import fits_as_well
from p2o.features.view import View
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.geometry.pose_error import is_distinct
from p2o.geometry.radial_error import RadialError, RadialFit
from p2o.host.stages import JudgeBase
from p2o.results.evidence import Accuracy, Agreement, Rival
from p2o.results.result import CameraCheck
from p2o.results.verdict import Doubt, Reason, Verdict

MIN_ODDS_RATIO, MIN_STRENGTH = 2.0, 11.0
"""Least agreement of the edges of a correct pose, as odds ratio and as evidence (`p2o.results.evidence.Agreement`)."""
_MIN_SIDE_ODDS = 1.8
"""Least odds ratio of the edges of each direction."""
MIN_PLACES = 12
"""Fewest independent cells of pairs, twice the number of unknowns. With fewer, errors of several degrees occurred at
odds ratios above 20, and the scatter of pairs did not reveal them.
"""


def rival_of(ends: Sequence[End], best: End, judge: JudgeBase) -> Rival | None:
    """Return the best end away from the best pose: its additional cost and its distance; None without one."""
    steps = {id(end): se3.inverse(end.pose) @ best.pose for end in ends if end.status.solved}
    others = [end for end in ends if end.status.solved and is_distinct(steps[id(end)])]
    if not others:
        return None
    cost_of_best, *costs = judge.costs([best.pose, *(end.pose for end in others)])
    cost, number = min((cost, i) for i, cost in enumerate(costs))
    step = steps[id(others[number])]
    return Rival(*judge.lead(cost_of_best, cost), se3.angle_deg(step), se3.distance_m(step))


def verdict_of(
    agreed: Agreement | None,
    rival: Rival | None,
    cameras: Sequence[CameraCheck],
    options: PipelineOptions,
    accuracy: Accuracy | None = None,
    *,
    places: int | None = None,
    min_places: int = MIN_PLACES,
    box: SearchBox | None = None,
) -> Verdict:
    """Return the verdict on a pose: doubtful where edges agree little more than under random alignment.

    It is also doubtful where its predicted error (`accuracy`) is large, or where pairs come from fewer than
    `min_places` independent image cells (`places`, None where unknown). `box` is that of the search if the pose is
    outside it.
    """
    reasons = [*_rival_doubts(rival), *agreement_doubts(agreed)]
    reasons += accuracy_doubts(accuracy, options)
    if places is not None and places < min_places:
        text = (
            f"the pairs are in only {places} independent cells of the image, and a predicted error needs {min_places}"
        )
        reasons.append(Reason(Doubt.TOO_FEW_PLACES, text))
    if box is not None:
        text = f"the pose is outside the searched box, {box.text} around the initial guess"
        reasons.append(Reason(Doubt.OUTSIDE_BOX, text))
    return Verdict((*reasons, *filter(None, map(camera_doubt, cameras))))


def _rival_doubts(rival: Rival | None) -> list[Reason]:
    """Return a reason for doubt where another pose fits as well."""
    if rival is None or not fits_as_well(rival):
        return []
    fewer = f"{rival.lead:.1f}"
    edges = "no fewer edges" if float(fewer) <= 0 else f"only {fewer} fewer edges"
    distance = f"{rival.rotation_deg:.2f} deg and {rival.translation_m:.2f} m"
    return [Reason(Doubt.RIVAL_POSE, f"another pose at a distance of {distance} matches {edges}")]


def agreement_doubts(agreed: Agreement | None) -> list[Reason]:
    """Return a reason for doubt where edges agree little more than under random alignment, or there are none."""
    if agreed is None:
        text = "no independent check of this pose was possible, because there are no edges of both sensors"
        return [Reason(Doubt.NOT_CHECKED, text)]
    if agreed.odds_ratio >= MIN_ODDS_RATIO and agreed.strength >= MIN_STRENGTH:
        return _direction_doubts(agreed)
    return [Reason(Doubt.LITTLE_AGREEMENT, little_agreement(agreed))]


def little_agreement(agreed: Agreement) -> str:
    """Return the sentence about edges that agree little more often than under random alignment, or in few cells."""
    if not agreed.points:
        return "no LiDAR edge is inside the image at this pose"
    return (
        f"edges of image and LiDAR agree little more often than under random alignment: odds ratio "
        f"{agreed.odds_ratio:.1f} and evidence {agreed.strength:.1f} in {agreed.places} independent cells, where a "
        f"correct pose has at least {MIN_ODDS_RATIO:g} and {MIN_STRENGTH:g}"
    )


def accuracy_doubts(accuracy: Accuracy | None, options: PipelineOptions) -> list[Reason]:
    """Return a reason for doubt where the 95 % bound of the predicted error exceeds the limits of the options."""
    if accuracy is None:
        return []
    bounds = ((accuracy.rotation_deg_95, options.most_deg, "deg"), (accuracy.translation_m_95, options.most_m, "m"))
    wide = [f"{value:.2f} {unit} exceeds {most:g} {unit}" for value, most, unit in bounds if value > most]
    return [Reason(Doubt.TOO_UNSURE, f"the predicted error (95 %) of {' and of '.join(wide)}")] if wide else []


_SIDE_WORDS = {"L": "left", "R": "right", "U": "above", "B": "below"}


def _direction_doubts(agreed: Agreement) -> list[Reason]:
    """Return a reason for doubt where the edges of one direction agree little more than under random alignment."""
    if agreed.least_odds is None or agreed.least_odds >= _MIN_SIDE_ODDS:
        return []
    side = _SIDE_WORDS[agreed.least_side]
    text = (
        f"LiDAR edges with the background {side}, unlike those of other directions, agree with image edges little more "
        f"often than under random alignment: odds ratio {agreed.least_odds:.1f}, where a correct pose has at least "
        f"{_MIN_SIDE_ODDS:g}"
    )
    return [Reason(Doubt.LITTLE_AGREEMENT, text)]


_PARAMETERS = ("focal length", "radial distortion", "principal point x", "principal point y")


def checks_of(estimate: NuisanceEstimate, cameras: Sequence[Camera]) -> tuple[CameraCheck, ...]:
    """Return the errors of the cameras as checks of a result; `cameras` are those of all frames."""
    if estimate.intrinsics is not None:
        return tuple(_check(fit, cameras.count(fit.camera)) for fit in estimate.intrinsics.fits)
    if not estimate.cameras_corrected:
        return ()
    errors = estimate.nuisance.errors
    fits = [replace(fit, error=errors[fit.camera]) for fit in estimate.cameras if fit.camera in errors]
    return tuple(_check(fit, cameras.count(fit.camera)) for fit in fits)


def _check(fit: RadialFit, frames: int) -> CameraCheck:
    """Return a check of a camera by its fit: one of all intrinsics is not corrected, one from pairs is."""
    focal_sigma, radial_sigma, *of_centre = np.sqrt(np.diag(fit.covariance)).tolist()
    of_all: dict[str, Any] = {}
    if isinstance(fit, IntrinsicFit):
        x_sigma, y_sigma = (sigma * fit.camera.focal_px for sigma in of_centre)
        wrong = tuple(name for name, wrong in zip(_PARAMETERS, fit.significant, strict=True) if wrong)
        of_all = {"x_sigma_px": x_sigma, "y_sigma_px": y_sigma, "evidence": fit.evidence, "wrong": wrong}
    return CameraCheck(
        frames=frames,
        camera=fit.camera,
        better=fit.error.corrected(fit.camera),
        focal=fit.error.focal,
        focal_sigma=focal_sigma,
        radial=fit.error.radial,
        radial_sigma=radial_sigma,
        shift_px=fit.error.shift_px(fit.camera),
        shift_sigma_px=fit.sigma_px,
        corrected=not of_all,
        x_px=fit.error.x_px,
        y_px=fit.error.y_px,
        **of_all,
    )


def at_full_size(checks: Sequence[CameraCheck], views: Sequence[View]) -> tuple[CameraCheck, ...]:
    """Return checks of downsampled images as checks of the cameras at full size."""
    given = {view.camera: view.full_size for view in views if view.full_size is not None}
    out = []
    for check in checks:
        camera = given.get(check.camera)
        if camera is not None:
            larger = camera.focal_px / check.camera.focal_px
            lengths = ("shift_px", "shift_sigma_px", "x_px", "x_sigma_px", "y_px", "y_sigma_px")
            check = replace(check, camera=camera, **{name: getattr(check, name) * larger for name in lengths})
            error = RadialError(check.focal, check.radial, check.x_px, check.y_px)
            check = replace(check, better=error.corrected(camera))
        out.append(check)
    return tuple(out)


def camera_doubt(check: CameraCheck) -> Reason | None:
    """Return a reason for doubt where errors of the intrinsics are significant and not corrected, else None."""
    if check.corrected or not check.wrong:
        return None
    values = {
        "focal length": f"{100 * check.focal:+.1f} % (sigma {100 * check.focal_sigma:.1f})",
        "radial distortion": f"{check.radial:+.3f} (sigma {check.radial_sigma:.3f})",
        "principal point x": f"{check.x_px:+.0f} px (sigma {check.x_sigma_px:.0f})",
        "principal point y": f"{check.y_px:+.0f} px (sigma {check.y_sigma_px:.0f})",
    }
    errors = ", ".join(f"{name} {values[name]}" for name in check.wrong)
    return Reason(
        Doubt.CAMERA,
        f"the camera's intrinsics are in doubt: the edges fit {check.evidence:.1f} sigma better with another {errors}",
    )
