"""`python -m tests.fuzz --cases 20000 --seed 1`: exit status 1 where a promise was broken."""

from __future__ import annotations

import os

# Forks of a process with several threads may wait for ever.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"

import gc
import shutil
import sys
import time
from pathlib import Path

import click

from tests.fuzz.bases import build
from tests.fuzz.campaign import Tally, campaign, one
from tests.fuzz.doors import SURFACES


@click.command()
@click.option("--cases", default=20_000, show_default=True, help="How many.")
@click.option("--seed", default=0, show_default=True, help="Other cases.")
@click.option("--jobs", default=os.cpu_count() or 1, show_default=True, help="Processes.")
@click.option("--door", "doors", multiple=True, type=click.Choice(list(SURFACES)), help="Only here.")
@click.option("--case", "number", type=int, help="This one again; its files stay, in OUT-again.")
@click.option("--out", default="build/fuzz", show_default=True, help="Where cases that break a promise stay.")
def fuzz(cases: int, seed: int, jobs: int, doors: tuple[str, ...], number: int | None, out: str) -> None:
    """Meet p2o with mutated inputs; see docs/reliability.md."""
    import cv2
    import torch

    cv2.setNumThreads(0)
    torch.set_num_threads(1)
    # A campaign may still be at work in `out`.
    root = Path(out if number is None else f"{out}-again").absolute()
    shutil.rmtree(root, ignore_errors=True)
    bases = build(root / "bases")
    # What is loaded stays in pages that forks share: a collector that walks it would copy them all.
    gc.collect()
    gc.freeze()
    chosen = list(doors or SURFACES)
    if number is not None:
        verdict = one(bases, root / f"case-{number}", seed, number, chosen, keep=True)
        print(f"p2o {' '.join(verdict.argv)!a}\n{verdict.kept}: status {verdict.status}, {verdict.broken or 'fine'}")
        sys.exit(1 if verdict.broken else 0)
    tally, begun = Tally(), time.monotonic()
    for verdict in campaign(bases, root, cases=cases, seed=seed, jobs=jobs, doors=chosen):
        tally.verdicts.append(verdict)
        if len(tally.verdicts) % 500 == 0:
            rate = len(tally.verdicts) / (time.monotonic() - begun)
            print(
                f"{len(tally.verdicts)} cases, {len(tally.bad)} broken, {rate:.0f} a second",
                file=sys.stderr,
                flush=True,
            )
    print(tally)
    sys.exit(1 if tally.bad else 0)


if __name__ == "__main__":
    fuzz()
