"""The figures of a result, each described once: name, unit, computation and wording.

JSON (`figures`), the terminal, the page of a run, and the columns and page of a study follow from `FIGURES`. A new
figure is one entry. `NOTES` describe the parts of a result that are lists or mappings; these are shown to a reader, and
stored as the parts that they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from p2o.arrays import Float
from p2o.geometry import se3
from p2o.results.evidence import Accuracy
from p2o.results.result import CameraCheck, Result, Status, SweepMotion

Value = float | int | str | None
"""What a figure can be; None where it is unknown."""
Line = tuple[str, str]
"""A label and a text."""


@dataclass(frozen=True)
class Figure:
    """One figure of a result.

    `name` is its key in JSON and its column in stores, `kind` its type (float, int or str). Figures of one `label`
    share one line. `text` is the wording around the formatted number, `{}`, with other figures by name
    (`{rival_unit}`), or empty; `below` is the wording of a negative number, without its sign. The number is multiplied
    by `scale`, formatted with `digits` (such as ".2f") and
    followed by `unit`.
    """

    name: str
    value: Callable[[Result], Value]
    label: str
    text: str = "{}"
    unit: str = ""
    digits: str = ".2f"
    scale: float = 1.0
    kind: type = float
    below: str = ""

    def worded(self, values: Mapping[str, Value]) -> str:
        """Return the wording of the figure, empty where the figure or another one in its text is unknown."""
        value = values.get(self.name)
        if value is None or not self.text:
            return ""
        text, number = self.text, value
        if not isinstance(value, str):
            number = f"{self.scale * value:{self.digits}}"
            if self.below and number.startswith("-"):
                text, number = self.below, number[1:]
            number = f"{number} {self.unit}".rstrip()
        known = {name: other for name, other in values.items() if other is not None}
        try:
            return " ".join(text.format(number, **known).split())
        except KeyError:
            return ""


@dataclass(frozen=True)
class Note:
    """A part of a result that is a list or a mapping: a `label`, and one text for each line."""

    label: str
    texts: Callable[[Result], Iterable[str]]


def _of(path: str) -> Callable[[Result], Value]:
    """Return a function that follows attributes from a result, to None where one of them is None."""

    def value(result: Result) -> Value:
        part: Any = result
        for name in path.split("."):
            part = getattr(part, name, None)
        known_value: Value = part
        return known_value

    return value


def _moved(result: Result) -> Float:
    return result.camera_from_lidar @ se3.inverse(result.start)


def _time_use(result: Result) -> str | None:
    return None if result.time is None else "corrected" if result.time.used else "not corrected"


_TRANSLATION = "translation error {} (67 %)"
_ROTATIONS = ("roll", "pitch", "yaw")
_AGREED, _PRIOR, _RIVAL = "agreement", "prior", "next best"
_PREDICTED, _BY_AXIS, _TIME = "predicted", "by axis", "time"

FIGURES: tuple[Figure, ...] = (
    Figure("moved_deg", lambda result: se3.angle_deg(_moved(result)), "moved", "{}", "deg", ".3f"),
    Figure("moved_m", lambda result: se3.distance_m(_moved(result)), "moved", "{} from the initial guess", "m", ".3f"),
    Figure("cost_initial", _of("judged.start"), "cost", "{} {cost_unit} at the initial guess", digits=".4g"),
    Figure("cost_result", _of("judged.estimate"), "cost", "{} {cost_unit} at the result", digits=".4g"),
    Figure(
        "cost_excess_truth",
        _of("judged.excess_truth"),
        "cost",
        "{} {cost_unit} more at the truth",
        digits=".4g",
        below="{} {cost_unit} less at the truth",
    ),
    Figure("cost_unit", _of("judged.unit"), "cost", "", kind=str),
    Figure("judge", _of("judged.judge"), "cost", "by {}", kind=str),
    Figure("near", _of("agreement.near"), _AGREED, "{} of LiDAR edges at an image edge", "%", ".0f", 100),
    Figure("chance", _of("agreement.chance"), _AGREED, "{} expected under random alignment", "%", ".0f", 100),
    Figure("odds_ratio", _of("agreement.odds_ratio"), _AGREED, "odds ratio {}", digits=".1f"),
    Figure("cells", _of("agreement.places"), _AGREED, "{} independent cells", digits="d", scale=1, kind=int),
    Figure("evidence", _of("agreement.strength"), _AGREED, "evidence {}", digits=".1f"),
    Figure("predicted_rotation_deg", _of("accuracy.rotation_deg"), _PREDICTED, "rotation error {} (67 %)", "deg"),
    Figure("predicted_rotation_deg_95", _of("accuracy.rotation_deg_95"), _PREDICTED, "{} (95 %)", "deg"),
    Figure("predicted_translation_m", _of("accuracy.translation_m"), _PREDICTED, _TRANSLATION, "m", ".3f"),
    Figure("predicted_translation_m_95", _of("accuracy.translation_m_95"), _PREDICTED, "{} (95 %)", "m", ".3f"),
    *(Figure(f"predicted_{a}_deg", _of(f"accuracy.{a}_deg"), _BY_AXIS, f"{a} {{}}", "deg") for a in _ROTATIONS),
    *(Figure(f"predicted_{a}_m", _of(f"accuracy.{a}_m"), _BY_AXIS, f"{a} {{}}", "m", ".3f") for a in ("x", "y")),
    Figure("predicted_z_m", _of("accuracy.z_m"), _BY_AXIS, "z {} (67 %, camera axes)", "m", ".3f"),
    Figure("prior_sigma_deg", _of("start_weight.sigma_deg"), _PRIOR, "initial guess: sigma {} per axis", "deg", "g"),
    Figure("prior_sigma_m", _of("start_weight.sigma_m"), _PRIOR, "{} per axis", "m", "g"),
    Figure("prior_step_deg", _of("start_weight.step_deg"), _PRIOR, "pose of the edges moved by {}", "deg"),
    Figure("prior_step_m", _of("start_weight.step_m"), _PRIOR, "{}", "m", ".3f"),
    Figure("rival_rotation_deg", _of("rival.rotation_deg"), _RIVAL, "pose at a distance of {}", "deg"),
    Figure("rival_translation_m", _of("rival.translation_m"), _RIVAL, "{}", "m"),
    Figure(
        "rival_lead",
        _of("rival.lead"),
        _RIVAL,
        "cost higher by {} {rival_unit}",
        digits=".1f",
        below="cost lower by {} {rival_unit}",
    ),
    Figure("rival_unit", _of("rival.unit"), _RIVAL, "", kind=str),
    Figure("time_offset_s", _of("time.offset_s"), _TIME, "images later than their timestamps by {}", "ms", "+.1f", 1e3),
    Figure("time_sigma_s", _of("time.sigma_s"), _TIME, "sigma {}", "ms", ".1f", 1e3),
    Figure("time_use", _time_use, _TIME, kind=str),
)


def figure_values(result: Result) -> dict[str, Value]:
    """Return the value of every figure by name; None where it is unknown or NaN."""
    values = ((figure, figure.value(result)) for figure in FIGURES)
    return {f.name: None if value is None or value != value else f.kind(value) for f, value in values}


def figure_lines(values: Mapping[str, Value]) -> list[Line]:
    """Return one line for each label, in the order of `FIGURES`; unknown figures are left out."""
    by_label: dict[str, list[str]] = {}
    for figure in FIGURES:
        by_label.setdefault(figure.label, []).append(figure.worded(values))
    return [(label, ", ".join(filter(None, texts))) for label, texts in by_label.items() if any(texts)]


def result_name(result: Result, camera: str = "") -> str:
    """Return the frame of a result or the number of its frames, with the camera unless the frame names it."""
    name = result.frames[0] if len(result.frames) == 1 else f"{len(result.frames)} frames jointly"
    return name if camera in name else f"{name} ({camera})"


def result_lines(result: Result) -> list[Line]:
    """Return the lines of all figures and notes of a result."""
    notes = ((note.label, text) for note in NOTES for text in note.texts(result))
    return [*figure_lines(figure_values(result)), *notes]


def status_text(status: Status) -> str:
    """Return `solved` if there is an estimate, which the verdict assesses, else the reason of the refusal."""
    return "solved" if status.solved else status.value


def accuracy_text(accuracy: Accuracy | None) -> str:
    """Return the wording of a predicted error, "unknown" for None."""
    names = ("rotation_deg", "translation_m", "rotation_deg_95", "translation_m_95")
    values = {f"predicted_{name}": getattr(accuracy, name, None) for name in names}
    return dict(figure_lines(values)).get(_PREDICTED, "unknown")


def provenance(result: Result) -> str:
    """Return the verdict and the predicted error of a result in one line, for comments in files."""
    a, text = result.accuracy, "unknown"
    if a is not None:
        bounds = ((a.rotation_deg, a.translation_m, 67), (a.rotation_deg_95, a.translation_m_95, 95))
        text = ", ".join(f"{deg:.2f} deg, {100 * metres:.1f} cm ({share} %)" for deg, metres, share in bounds)
    return f"p2o: {result.verdict.trust}; predicted error {text}"


# ---- notes


def _unknown_accuracy(result: Result) -> Iterator[str]:
    if result.matches and result.status.solved and result.accuracy is None:
        yield "unknown"


def _matches(result: Result) -> Iterator[str]:
    if result.matches:
        sides = ", ".join(f"{side} {count}" for side, count in result.matches.items())
        yield f"{sum(result.matches.values())}: {sides}"


def _residual(result: Result) -> Iterator[str]:
    if result.residual_px:
        yield ", ".join(f"{side} {value:.2f} px" for side, value in result.residual_px.items())


def _camera(check: CameraCheck) -> str:
    focal = f"focal length {100 * check.focal:+.2f} % (sigma {100 * check.focal_sigma:.2f})"
    radial = f"radial distortion {check.radial:+.4f} (sigma {check.radial_sigma:.4f})"
    sigmas = f"{check.x_sigma_px:.0f}, {check.y_sigma_px:.0f}"
    centre = f"principal point {check.x_px:+.0f}, {check.y_px:+.0f} px (sigma {sigmas})"
    return f"{focal}, {radial}, {centre}, {'corrected' if check.corrected else 'not corrected'}"


def _motion(motions: Sequence[SweepMotion]) -> Iterator[str]:
    """Yield the motion estimated from edges; the range over several frames."""
    if len(motions) == 1:
        (m,) = motions
        speed = f"{m.speed_m_s:.1f} m/s (sigma {m.speed_sigma:.1f})"
        yield f"{speed} forward, {m.turn_deg_s:.1f} deg/s (sigma {m.turn_sigma:.1f}) to the left: compensated"
    elif motions:
        speeds, turns = [m.speed_m_s for m in motions], [m.turn_deg_s for m in motions]
        speed, turn = (f"{min(values):.1f} to {max(values):.1f}" for values in (speeds, turns))
        yield f"{speed} m/s forward, {turn} deg/s to the left over {len(motions)} frames: compensated"


def _seconds(result: Result) -> Iterator[str]:
    if result.seconds:
        yield ", ".join(f"{stage} {seconds:.2f}" for stage, seconds in result.seconds.items())


def _licences(result: Result) -> Iterator[str]:
    """Yield the licence of the weights of each stage; equal ones once, without the stage if it is the extractor."""
    by_text: dict[str, list[str]] = {}
    for stage, text in result.licences.items():
        by_text.setdefault(text, []).append(stage)
    for text, stages in by_text.items():
        yield text if "extractor" in stages else f"{text} ({', '.join(stages)})"


def warnings_of(result: Result) -> list[str]:
    """Return each warning once, a warning of several frames with their number, and none that is in the verdict."""
    by_text: dict[str, list[str]] = {}
    reasons = {reason.text for reason in result.verdict.reasons}
    for warning in (text for text in result.warnings if text not in reasons):
        name, colon, text = warning.partition(": ")
        frame = name if colon and name in result.frames else ""
        by_text.setdefault(text if frame else warning, []).append(frame)
    return [
        text if not names[0] else f"{names[0]}: {text}" if len(names) == 1 else f"{len(names)} frames: {text}"
        for text, names in by_text.items()
    ]


NOTES: tuple[Note, ...] = (
    Note(_PREDICTED, _unknown_accuracy),
    Note("matches", _matches),
    Note("residual", _residual),
    Note("camera", lambda result: map(_camera, result.cameras)),
    Note("motion", lambda result: _motion(result.motions)),
    Note("seconds", _seconds),
    Note("weights", _licences),
    Note("warning", warnings_of),
)
