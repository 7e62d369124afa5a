"""The text that `p2o run` prints about results."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

from p2o.errors import printable
from p2o.geometry.pose_error import AXES
from p2o.results.advice import next_steps
from p2o.results.figures import accuracy_text, result_lines, result_name, status_text, warnings_of
from p2o.results.verdict import Trust
from p2o.run.protocol import figures_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from p2o.arrays import Float
    from p2o.geometry.pose_error import PoseError
    from p2o.results.result import Result, RigResult
    from p2o.run.outcome import FailedFrame, Row, Run


MOST_LINES = 8
"""Lines about a result without --verbose."""


def describe(row: Row) -> str:
    """Return the text about one result: status, verdict, poses, errors, and every figure (`p2o.results.figures`)."""
    result = row.result
    lines = [
        result_name(result, row.camera),
        f"  {'status':<9} {status_text(result.status)}: {result.reason}",
        *_verdict(result),
    ]
    lines += _pose("initial", result.start) + _pose("result", result.camera_from_lidar)
    if row.start_error is not None and row.error is not None:
        lines += _errors(row.start_error, row.error)
    lines += [f"  {label:<9} {text}" for label, text in result_lines(result)]
    return "\n".join(map(printable, lines))


def describe_briefly(row: Row, most: int = MOST_LINES) -> str:
    """Return at most eight lines about one result: verdict, pose, error, predicted error, remarks and next step.

    The next step is left out if there would be more than `most` lines.
    """
    result, solved = row.result, row.result.status.solved
    lines = [result_name(result, row.camera)]
    if not solved:
        lines.append(f"  {'status':<9} {status_text(result.status)}: {result.reason}")
    lines += _verdict(result)
    if solved:
        lines += _pose("result", result.camera_from_lidar)
        if row.start_error is not None and row.error is not None:
            before, after = (f"{e.rotation_deg:.3f} deg {e.translation_m:.3f} m" for e in (row.start_error, row.error))
            lines.append(f"  {'error':<9} {after} ({before} of the initial guess)")
        lines.append(f"  {'predicted':<9} {accuracy_text(result.accuracy)}")
    remarks = {"warning": "; ".join(warnings_of(result)), "weights": dict(result_lines(result)).get("weights", "")}
    lines += [f"  {label:<9} {text}" for label, text in remarks.items() if text][: MOST_LINES - len(lines)]
    if not result.verdict.trusted and len(lines) < most and (steps := next_steps(result)):
        lines.append(f"  {'next':<9} {steps[0]}")
    return "\n".join(map(printable, lines))


def describe_rig(rig: RigResult, errors: Mapping[str, PoseError]) -> str:
    """Return the text about the common result of a rig: pose, verdict, and each camera compared with the others."""
    lines = ["rig", f"  {'result':<9} {rig.reason}"]
    why = rig.verdict.why if rig.body_from_lidar is not None else ""
    lines.append(f"  {'verdict':<9} {rig.verdict.trust.value}" + (f": {why}" if why else ""))
    if rig.body_from_lidar is not None:
        lines += _pose("lidar at", rig.body_from_lidar)
        lines.append(f"  {'predicted':<9} {accuracy_text(rig.accuracy)}")
        test = "no camera is trusted alone"
        if rig.p_value is not None:
            test = f"chi-square {rig.chi_square:.1f}, {rig.degrees} degrees of freedom, p-value {rig.p_value:.2g}"
        lines.append(f"  {'agreement':<9} {test}")
    for camera in rig.cameras:
        texts = [f"left out: {camera.left_out}"] if camera.left_out else []
        if camera.rotation_deg is not None:
            texts = [f"own result {camera.rotation_deg:.2f} deg and {camera.translation_m:.3f} m from the common one"]
        if camera.name in errors:
            error = errors[camera.name]
            texts.append(f"error of the common result {error.rotation_deg:.3f} deg {error.translation_m:.3f} m")
        lines.append(f"  {'camera':<9} {camera.name}" + (f": {'; '.join(texts)}" if texts else ""))
    return "\n".join(map(printable, lines))


def describe_failed(failed: FailedFrame) -> str:
    """Return the text about a frame that has no result."""
    return "\n".join(map(printable, [failed.frame, f"  {'failed':<9} {failed.reason}"]))


def describe_run(run: Run) -> str:
    """Return the summary of many results: counts by status and by verdict, then means and medians of the errors."""
    summary = run.summary
    by_text = Counter(status_text(row.result.status) for row in run.rows)
    counts = ", ".join(f"{count} {status}" for status, count in sorted(by_text.items()))
    lines = [f"{summary['count']} calibrations: {counts or 'none finished'}"]
    if run.failed:
        sort = "frames" if run.rig is None else "cameras"
        lines.append(f"  {len(run.failed)} {sort} failed: they could not be read or lack what the methods need")
    solved = Counter(row.result.verdict.trust for row in run.rows if row.result.status.solved)
    if solved:
        words = ", ".join(f"{solved[trust]} {trust}" for trust in Trust if solved[trust])
        lines.append(f"  {solved.total()} solved: {words}")
    for key, label in (("start", "initial"), ("error", "error")):
        values = summary[key]
        if values.get("count"):
            mean, median = (
                f"{word} {values[f'rotation_deg_{word}']:.3f} deg {values[f'translation_m_{word}']:.3f} m"
                for word in ("mean", "median")
            )
            lines.append(f"  {label:<7} {mean}, {median} ({values['count']} solved)")
    if run.protocol is not None:
        figures = {name: value for name, value in summary["protocol"].items() if name not in ("name", "count")}
        lines.append(f"  {figures_text(run.protocol, figures)}")
    return "\n".join(lines)


def _verdict(result: Result) -> list[str]:
    """Return the verdict with its reasons; the reason of the status is not repeated."""
    why = "; ".join(reason.text for reason in result.verdict.reasons if reason.text != result.reason)
    return [f"  {'verdict':<9} {result.verdict.trust.value}" + (f": {why}" if why else "")]


def _pose(label: str, pose: Float) -> list[str]:
    rows = [" ".join(f"{value: .6f}" for value in row) for row in pose[:3]]
    return [f"  {label:<9} {rows[0]}", *(f"  {'':<9} {row}" for row in rows[1:])]


def _errors(before: PoseError, after: PoseError) -> list[str]:
    head = "  ".join(f"{axis.partition('_')[0]:>7}" for axis in AXES)
    lines = [f"  {'error':<9} {'deg':>7}  {'m':>7}  {head}"]
    for label, error in (("initial", before), ("result", after)):
        axes = "  ".join(f"{error.per_axis[axis]:>7.3f}" for axis in AXES)
        lines.append(f"    {label:<7} {error.rotation_deg:>7.3f}  {error.translation_m:>7.3f}  {axes}")
    return lines
