"""The evidence beside a result in words: one wording for the terminal and the page."""

from __future__ import annotations

from collections.abc import Sequence

from p2o.results.accuracy import Accuracy
from p2o.results.evidence import Agreement, Judged, Rival, StartWeight
from p2o.results.result import DIRECTED, CameraCheck, Result, SweepMotion, TimeOffset


def agreement_words(met: Agreement) -> str:
    """Return how the edges of both sensors meet."""
    share = f"{100 * met.near:.0f} % of the LiDAR edges meet an image edge, {100 * met.chance:.0f} % by chance"
    return f"{share} (odds ratio {met.odds_ratio:.1f}, in {met.places} places: strength {met.strength:.1f})"


def rival_words(rival: Rival) -> str:
    """Return where the next best pose is, and by how much it is worse."""
    apart = f"{rival.rotation_deg:.2f} deg and {rival.translation_m:.2f} m away"
    return f"{apart}, {rival.lead:.1f} {rival.unit} worse"


def judged_words(judged: Judged) -> tuple[str, str]:
    """Return what the judge measures, and what it was before and after."""
    if judged.judge == DIRECTED:
        return "edge gap", f"{judged.start:.2f} px at the start, {judged.estimate:.2f} px at the result"
    costs = (f"{cost:.4g} {judged.unit}".rstrip() for cost in (judged.start, judged.estimate))
    return "cost", f"{' at the start, '.join(costs)} at the result, by {judged.judge}"


def warning_lines(result: Result) -> list[str]:
    """Return the warnings, each text once: the same one of many frames is told with their number."""
    by_text: dict[str, list[str]] = {}
    for warning in result.warnings:
        name, colon, text = warning.partition(": ")
        frame = name if colon and name in result.frames else ""
        by_text.setdefault(text if frame else warning, []).append(frame)
    return [
        text if not names[0] else f"{names[0]}: {text}" if len(names) == 1 else f"{len(names)} frames: {text}"
        for text, names in by_text.items()
    ]


def accuracy_words(accuracy: Accuracy | None) -> str:
    """Return how wrong such results are."""
    if accuracy is None:
        return "cannot be told"
    usual = f"{accuracy.rotation_deg:.2f} deg and {accuracy.translation_m:.3f} m"
    rare = f"{accuracy.rotation_deg_95:.2f} deg and {accuracy.translation_m_95:.3f} m"
    return f"two of three such results are within {usual}, 19 of 20 within {rare}"


def start_words(weight: StartWeight) -> str:
    """Return what the start was worth."""
    good = f"weighed in as good to {weight.sigma_deg:g} deg and {weight.sigma_m:g} m an axis"
    return f"{good}: moved the pose of the edges by {weight.step_deg:.2f} deg and {weight.step_m:.3f} m"


def axis_words(accuracy: Accuracy) -> str:
    """Return the likely errors by axis."""
    turns = ", ".join(f"{name} {getattr(accuracy, f'{name}_deg'):.2f}" for name in ("roll", "pitch", "yaw"))
    shifts = ", ".join(f"{name} {getattr(accuracy, f'{name}_m'):.3f}" for name in "xyz")
    return f"{turns} deg; {shifts} m (two of three, camera axes)"


def camera_words(check: CameraCheck) -> str:
    """Return what the edges say about a camera's calibration."""
    focal = f"focal length {100 * check.focal:+.2f} % (+-{100 * check.focal_sigma:.2f})"
    radial = f"radial distortion {check.radial:+.4f} (+-{check.radial_sigma:.4f})"
    shift = f"up to {check.shift_px:.1f} px (+-{check.shift_sigma_px:.1f})"
    return f"{focal}, {radial}: {shift}" + (", corrected" if check.corrected else "")


def motion_words(motions: Sequence[SweepMotion]) -> str:
    """Return how the car moved; of several frames the range."""
    if len(motions) == 1:
        (m,) = motions
        speed = f"{m.speed_m_s:.1f} m/s (+-{m.speed_sigma:.1f})"
        return (
            f"{speed} forward, {m.turn_deg_s:.1f} deg/s (+-{m.turn_sigma:.1f}) to the left: the edges tell, compensated"
        )
    speeds, turns = [m.speed_m_s for m in motions], [m.turn_deg_s for m in motions]
    speed, turn = (f"{min(values):.1f} to {max(values):.1f}" for values in (speeds, turns))
    return f"{speed} m/s forward, {turn} deg/s to the left, by frame: the edges tell, compensated"


def time_words(time: TimeOffset) -> str:
    """Return how much later than the data say the images were taken."""
    offset = f"{1000 * time.offset_s:+.1f} ms (+-{1000 * time.sigma_s:.1f})"
    return f"images later than told by {offset}: the edges tell, " + ("corrected" if time.used else "not used")
