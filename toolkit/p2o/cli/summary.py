"""What `p2o run` says about results to a reader."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from p2o.errors import printable
from p2o.geometry import se3
from p2o.results.evidence_words import (
    accuracy_words,
    agreement_words,
    axis_words,
    camera_words,
    judged_words,
    motion_words,
    rival_words,
    start_words,
    time_words,
    warning_lines,
)
from p2o.results.verdict import Trust
from p2o.run.protocol import told

if TYPE_CHECKING:
    from collections.abc import Mapping

    from p2o.arrays import Float
    from p2o.geometry.pose_error import PoseError
    from p2o.results.result import Result
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
        label, words = judged_words(result.judged)
        lines.append(f"  {label:<9} {words}")
    if result.agreement is not None:
        lines.append(f"  {'agreement':<9} {agreement_words(result.agreement)}")
    if result.matches and result.status.solved:
        lines.append(f"  {'accuracy':<9} {accuracy_words(result.accuracy)}")
        if result.accuracy is not None and result.accuracy.roll_deg is not None:
            lines.append(f"  {'by axis':<9} {axis_words(result.accuracy)}")
    if result.start_weight is not None:
        lines.append(f"  {'start':<9} {start_words(result.start_weight)}")
    if result.rival is not None:
        lines.append(f"  {'next best':<9} {rival_words(result.rival)}")
    lines += [f"  {'camera':<9} {camera_words(check)}" for check in result.cameras]
    if result.motions:
        lines.append(f"  {'motion':<9} {motion_words(result.motions)}")
    if result.time is not None:
        lines.append(f"  {'time':<9} {time_words(result.time)}")
    if result.seconds:
        lines.append(f"  {'seconds':<9} " + ", ".join(f"{stage} {took:.2f}" for stage, took in result.seconds.items()))
    lines += [f"  {'warning':<9} {text}" for text in warning_lines(result)]
    return "\n".join(map(printable, lines))


def describe_rig(rig: RigResult, errors: Mapping[str, PoseError]) -> str:
    """Return the account of the common result of a rig: pose, verdict, and what each camera says beside the others."""
    lines = ["rig", f"  {'result':<9} {rig.reason}"]
    why = rig.verdict.why if rig.body_from_lidar is not None else ""
    lines.append(f"  {'verdict':<9} {rig.verdict.trust.value}" + (f": {why}" if why else ""))
    if rig.body_from_lidar is not None:
        lines += _pose("lidar at", rig.body_from_lidar)
        lines.append(f"  {'accuracy':<9} {accuracy_words(rig.accuracy)}")
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
