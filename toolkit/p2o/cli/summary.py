"""What `p2o run` says about results to a reader."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from p2o.errors import printable
from p2o.geometry import se3
from p2o.results.result import DIRECTED
from p2o.results.verdict import Trust
from p2o.run.protocol import told

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from p2o.arrays import Float
    from p2o.geometry.pose_error import PoseError
    from p2o.results.accuracy import Accuracy
    from p2o.results.evidence import Judged, StartWeight
    from p2o.results.result import CameraCheck, Result, SweepMotion, TimeOffset
    from p2o.results.rig import RigResult
    from p2o.run.run import FailedFrame, Row, Run

_AXES = (("roll", "deg"), ("pitch", "deg"), ("yaw", "deg"), ("x", "m"), ("y", "m"), ("z", "m"))


def describe(row: Row) -> str:
    """Return the readable account of one result: poses, errors, matches and residuals by direction, status."""
    result = row.result
    name = result.frames[0] if len(result.frames) == 1 else f"{len(result.frames)} frames jointly"
    if row.camera not in name:
        name = f"{name} ({row.camera})"
    lines = [name, f"  {'status':<9} {result.status.value}: {result.reason}", *_verdict(result)]
    lines += _pose("start", result.start) + _pose("result", result.camera_from_lidar)
    lines.append(f"  {'moved':<9} {_distance(result.camera_from_lidar @ se3.inverse(result.start))}")
    if row.start_error is not None and row.error is not None:
        lines += _errors(row.start_error, row.error)
    if result.matches:
        parts = [f"{side} {count}" for side, count in result.matches.items()]
        lines.append(f"  {'matches':<9} {sum(result.matches.values())}: " + ", ".join(parts))
    if result.residual_px:
        lines.append(f"  {'residual':<9} " + ", ".join(f"{k} {v:.2f} px" for k, v in result.residual_px.items()))
    if result.judged is not None:
        lines.append(_judged(result.judged))
    if result.agreement is not None:
        met = result.agreement
        share = f"{100 * met.near:.0f} % of the LiDAR edges meet an image edge, {100 * met.chance:.0f} % by chance"
        told = f"odds ratio {met.odds_ratio:.1f}, in {met.places} places: strength {met.strength:.1f}"
        lines.append(f"  {'agreement':<9} {share} ({told})")
    if result.matches and result.status.solved:
        lines.append(f"  {'accuracy':<9} {_accuracy(result.accuracy)}")
        if result.accuracy is not None and result.accuracy.roll_deg is not None:
            lines.append(f"  {'by axis':<9} {_axes(result.accuracy)}")
    if result.start_weight is not None:
        lines.append(f"  {'start':<9} {_start(result.start_weight)}")
    if result.rival is not None:
        apart = f"{result.rival.rotation_deg:.2f} deg and {result.rival.translation_m:.2f} m away"
        lines.append(f"  {'next best':<9} {apart}, {result.rival.lead:.1f} {result.rival.unit} worse")
    lines += [f"  {'camera':<9} {_camera(check)}" for check in result.cameras]
    if result.motions:
        lines.append(f"  {'motion':<9} {_motions(result.motions)}")
    if result.time is not None:
        lines.append(f"  {'time':<9} {_time(result.time)}")
    if result.seconds:
        lines.append(f"  {'seconds':<9} " + ", ".join(f"{stage} {took:.2f}" for stage, took in result.seconds.items()))
    lines += [f"  {'warning':<9} {text}" for text in _warnings(result)]
    return "\n".join(map(printable, lines))


def describe_rig(rig: RigResult, errors: Mapping[str, PoseError]) -> str:
    """Return the account of the common result of a rig: pose, verdict, and what each camera says beside the others."""
    lines = ["rig", f"  {'result':<9} {rig.reason}"]
    why = rig.verdict.why if rig.body_from_lidar is not None else ""
    lines.append(f"  {'verdict':<9} {rig.verdict.trust.value}" + (f": {why}" if why else ""))
    if rig.body_from_lidar is not None:
        lines += _pose("lidar at", rig.body_from_lidar)
        lines.append(f"  {'accuracy':<9} {_accuracy(rig.accuracy)}")
        lines.append(
            f"  {'apart':<9} chi-square {rig.chi_square:.1f} for {rig.degrees}, by chance in {rig.p_value:.2g}"
        )
    for camera in rig.cameras:
        said = f"left out: {camera.left_out}" if camera.left_out else ""
        if camera.rotation_deg is not None:
            said = f"by itself {camera.rotation_deg:.2f} deg and {camera.translation_m:.3f} m from the others"
        if camera.name in errors:
            error = errors[camera.name]
            told = f"error {error.rotation_deg:.3f} deg {error.translation_m:.3f} m in common"
            said = f"{said}; {told}" if said else told
        lines.append(f"  {'camera':<9} {camera.name}" + (f": {said}" if said else ""))
    return "\n".join(map(printable, lines))


def describe_failed(failed: FailedFrame) -> str:
    """Return the account of a frame that has no result."""
    return "\n".join(map(printable, [failed.frame, f"  {'failed':<9} {failed.reason}"]))


def describe_run(run: Run) -> str:
    """Return the summary of many results: counts by status and by verdict, then means and medians of the errors."""
    summary = run.summary
    counts = ", ".join(f"{count} {status}" for status, count in summary["status"].items())
    lines = [f"{summary['count']} calibrations: {counts or 'none finished'}"]
    if run.failed:
        sort = "frames" if run.rig is None else "cameras"
        lines.append(f"  {len(run.failed)} {sort} failed: they could not be read or lack what the methods need")
    solved = Counter(row.result.verdict.trust for row in run.rows if row.result.status.solved)
    if solved:
        words = ", ".join(f"{solved[trust]} {trust}" for trust in Trust if solved[trust])
        lines.append(f"  {solved.total()} solved: {words}")
    for label in ("start", "error"):
        values = summary[label]
        if values.get("count"):
            lines.append(
                f"  {label:<6} mean {values['rotation_deg_mean']:.3f} deg {values['translation_m_mean']:.3f} m, "
                f"median {values['rotation_deg_median']:.3f} deg {values['translation_m_median']:.3f} m"
                f" ({values['count']} solved)"
            )
    if run.protocol is not None:
        figures = {name: value for name, value in summary["protocol"].items() if name not in ("name", "count")}
        lines.append(f"  {told(run.protocol, figures)}")
    return "\n".join(lines)


def _verdict(result: Result) -> list[str]:
    """Return the word with what speaks for it, and remarks; what the line of the status says is not said again."""
    reasons = [reason for reason in result.verdict.reasons if reason.text != result.reason]
    why = "; ".join(reason.text for reason in reasons if reason.doubt.trust)
    lines = [f"  {'verdict':<9} {result.verdict.trust.value}" + (f": {why}" if why else "")]
    return lines + [f"  {'remark':<9} {reason.text}" for reason in reasons if not reason.doubt.trust]


def _judged(judged: Judged) -> str:
    """Return what the costs were before and after."""
    if judged.judge == DIRECTED:
        return f"  {'edge gap':<9} {judged.start:.2f} px at the start, {judged.estimate:.2f} px at the result"
    costs = (f"{cost:.4g} {judged.unit}".rstrip() for cost in (judged.start, judged.estimate))
    return f"  {'cost':<9} {' at the start, '.join(costs)} at the result, by {judged.judge}"


def _warnings(result: Result) -> list[str]:
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


def _accuracy(accuracy: Accuracy | None) -> str:
    """Return how wrong such results are."""
    if accuracy is None:
        return "cannot be told"
    usual = f"{accuracy.rotation_deg:.2f} deg and {accuracy.translation_m:.3f} m"
    rare = f"{accuracy.rotation_deg_95:.2f} deg and {accuracy.translation_m_95:.3f} m"
    return f"two of three such results are within {usual}, 19 of 20 within {rare}"


def _start(weight: StartWeight) -> str:
    """Return what the start was worth."""
    good = f"weighed in as good to {weight.sigma_deg:g} deg and {weight.sigma_m:g} m an axis"
    return f"{good}: moved the pose of the edges by {weight.step_deg:.2f} deg and {weight.step_m:.3f} m"


def _axes(accuracy: Accuracy) -> str:
    """Return the likely errors by axis."""
    turns = ", ".join(f"{name} {getattr(accuracy, f'{name}_deg'):.2f}" for name in ("roll", "pitch", "yaw"))
    shifts = ", ".join(f"{name} {getattr(accuracy, f'{name}_m'):.3f}" for name in "xyz")
    return f"{turns} deg; {shifts} m (two of three, camera axes)"


def _camera(check: CameraCheck) -> str:
    """Return what the edges say about a camera's calibration."""
    focal = f"focal length {100 * check.focal:+.2f} % (+-{100 * check.focal_sigma:.2f})"
    radial = f"radial distortion {check.radial:+.4f} (+-{check.radial_sigma:.4f})"
    shift = f"up to {check.shift_px:.1f} px (+-{check.shift_sigma_px:.1f})"
    return f"{focal}, {radial}: {shift}" + (", corrected" if check.corrected else "")


def _motions(motions: Sequence[SweepMotion]) -> str:
    """Return how the car moved; of several frames the range."""
    if len(motions) == 1:
        (m,) = motions
        speed = f"{m.speed_m_s:.1f} m/s (+-{m.speed_sigma:.1f})"
        return (
            f"{speed} forward, {m.turn_deg_s:.1f} deg/s (+-{m.turn_sigma:.1f}) to the left: the edges tell, corrected"
        )
    speeds, turns = [m.speed_m_s for m in motions], [m.turn_deg_s for m in motions]
    speed, turn = (f"{min(values):.1f} to {max(values):.1f}" for values in (speeds, turns))
    return f"{speed} m/s forward, {turn} deg/s to the left, by frame: the edges tell, corrected"


def _time(time: TimeOffset) -> str:
    """Return how much later than the data say the images were taken."""
    offset = f"{1000 * time.offset_s:+.1f} ms (+-{1000 * time.sigma_s:.1f})"
    return f"images later than told by {offset}: the edges tell, " + ("corrected" if time.used else "not used")


def _pose(label: str, pose: Float) -> list[str]:
    rows = [" ".join(f"{value: .6f}" for value in row) for row in pose[:3]]
    return [f"  {label:<9} {rows[0]}", *(f"  {'':<9} {row}" for row in rows[1:])]


def _distance(step: Float) -> str:
    return f"{se3.angle_deg(step):.3f} deg, {se3.distance_m(step):.3f} m"


def _errors(before: PoseError, after: PoseError) -> list[str]:
    head = "  ".join(f"{axis:>7}" for axis, _ in _AXES)
    lines = [f"  {'error':<9} {'deg':>7}  {'m':>7}  {head}"]
    for label, error in (("before", before), ("after", after)):
        axes = "  ".join(f"{error.per_axis[f'{axis}_{unit}']:>7.3f}" for axis, unit in _AXES)
        lines.append(f"    {label:<7} {error.rotation_deg:>7.3f}  {error.translation_m:>7.3f}  {axes}")
    return lines
