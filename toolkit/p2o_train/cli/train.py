"""`p2o train`: train a method on frames; everything about the training is kept in one folder."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click
from p2o.cli.plugin_options import load
from p2o.errors import InputError, UnknownNameError, printable

from p2o_train.cli.progress import shown, training_data_options

if TYPE_CHECKING:
    from p2o.host.method import Trainer
    from p2o.options import Options


@click.command("train")
@training_data_options
@click.option("--preset", metavar="NAME", help="A named set of options (docs/training.md lists them).")
@click.option("--encoder", metavar="NAME", help="Same as --set encoder=NAME.")
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Same as --set seed=N.")
@click.option("--set", "settings", multiple=True, metavar="FIELD=VALUE", help="An option, such as iterations=3000.")
@click.option(
    "--share",
    "shares",
    multiple=True,
    type=click.FloatRange(min=0, min_open=True),
    metavar="X",
    help="Weight of the i-th --data in the training (default: equal).",
)
@click.option(
    "--validate",
    "held_out",
    multiple=True,
    metavar="PATTERN",
    help="Hold out frames with matching names, such as '*/0018/*', for validation.",
)
def command(
    method: str,
    data: tuple[str, ...],
    frames: tuple[str, ...],
    out: str,
    preset: str | None,
    encoder: str | None,
    seed: int | None,
    settings: tuple[str, ...],
    shares: tuple[float, ...],
    held_out: tuple[str, ...],
    quiet: bool,
    **plugins: Any,
) -> int:
    """Train a method on frames, or resume a training, and print the path of the weights and how to use them.

    \b
    p2o train p2ornet --data kitti-raw:PATH --frames @splits.json#train --validate '*/0018/*' --out trained
    p2o train p2ornet --data kitti-raw:PATH --data "synthetic:?scenes=100" --share 0.5 --share 0.5 --out both

    All files are written to the folder of --out. After an interruption, the same command resumes the training.
    docs/training.md explains options, presets and files.
    """  # noqa: D301  (click wants a real backspace: the examples keep their lines)
    from p2o.cli.out_dir import OutDir

    from p2o_train.guarded_trainer import trainer_of
    from p2o_train.train import sources_of, train, trainable, usage

    if not all(map(math.isfinite, shares)):
        raise InputError("the share is not finite", where="--share", expected="more than 0", got=max(shares))
    registry = load(**plugins)
    offer = trainable(method, registry)
    trainer = trainer_of(offer)
    given = {name: value for name, value in (("encoder", encoder), ("seed", seed)) if value is not None}
    options = _options(trainer, preset, given, settings)
    sources = sources_of(offer, data, frames, registry)
    root = OutDir.prepared(out).root
    with shown(quiet) as show:
        try:
            weights = train(offer, options, sources, shares, held_out, root, on_label=show.label, on_progress=show.step)
        except KeyboardInterrupt:
            click.echo("p2o: interrupted: the same command continues", err=True)
            return 130
    click.echo(printable(weights))
    click.echo(printable(usage(offer, trainer.weights_option, weights)))
    return 0


def _options(trainer: Trainer, preset: str | None, given: Mapping[str, Any], settings: tuple[str, ...]) -> Options:
    """Return the validated options: the preset, then `given`, then `settings`."""
    from p2o.options import validated
    from p2o.run.words import parse_fields

    if preset is not None and preset not in trainer.presets:
        raise UnknownNameError("preset", preset, trainer.presets, where="--preset")
    values = {**(trainer.presets[preset] if preset is not None else {}), **given}
    values = parse_fields(settings, values, example="iterations=3000")
    return validated(trainer.options, values, "train")
