"""The options --data and --frames of the commands that learn from frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from p2o.cli.plugin_options import plugin_options


def training_data_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add METHOD, --data, --frames, --out, --quiet and the options of plugins to a command."""
    command = plugin_options(command)
    command = click.option("--quiet", is_flag=True, help="No progress.")(command)
    command = click.option(
        "--out", required=True, type=click.Path(file_okay=False), metavar="DIR", help="Write here (made if need be)."
    )(command)
    command = click.option(
        "--frames",
        multiple=True,
        metavar="SPEC",
        help="Which frames, as in `p2o run`: one for all data, or the i-th for the i-th --data (default: all).",
    )(command)
    command = click.option(
        "--data",
        multiple=True,
        required=True,
        metavar="[NAME=]DATASET:PATH",
        help="Learn from these frames; several times for several data.",
    )(command)
    return click.argument("method", metavar="METHOD")(command)
