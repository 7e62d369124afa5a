"""The options --start and --pose of commands that look from a pose and calibrate nothing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click


def pose_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --start (or --extrinsic) and --pose to a command; it gets them as `start` and `pose`."""
    command = click.option(
        "--pose",
        type=click.Choice(["start", "truth"]),
        default="start",
        show_default=True,
        help="Which pose of the data: the start, or the calibration that they give.",
    )(command)
    return click.option(
        "--start",
        "--extrinsic",
        "start",
        metavar='FILE | roughly "WORDS"',
        help="Look from the pose of a calibration file, or from one told in words.",
    )(command)
