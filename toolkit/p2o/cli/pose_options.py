"""The options --start, --pose and --most, and the two-word form `--start roughly "WORDS"`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click


class StartCommand(click.Command):
    """A command that accepts `--start FILE`, `--start "roughly WORDS"` and `--start roughly "WORDS"`."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Join the two words after --start, unless the second one is an option."""
        joined: list[str] = []
        for word in args:
            # A description begins with a letter, hence a word that begins with - is the next option.
            if joined[-2:-1] in (["--start"], ["--extrinsic"]) and joined[-1] == "roughly" and not word.startswith("-"):
                joined[-1] = f"roughly {word}"
            else:
                joined.append(word)
        return super().parse_args(ctx, joined)


def pose_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add --start (or --extrinsic) and --pose to a `StartCommand`, which gets them as `start` and `pose`."""
    which = "Which pose of the data: the start, or the calibration that they give."
    poses = click.Choice(["start", "truth"])
    command = click.option("--pose", type=poses, default="start", show_default=True, help=which)(command)
    project = "Project from the pose of a calibration file, or from one described in words."
    return click.option("--start", "--extrinsic", "start", metavar='FILE | roughly "WORDS"', help=project)(command)


def most_option(default: int, limit: int, text: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the option --most, a number of frames of at most `limit`."""
    count = click.IntRange(min=1, max=limit)
    return click.option("--most", type=count, default=default, show_default=True, metavar="N", help=text)
