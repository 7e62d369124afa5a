"""What fits together: words that methods need and give, and what frames hold."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from p2o.errors import InputError
from p2o.frames.frame import Frame
from p2o.host.method import Kind
from p2o.host.registry import Offer, Registry
from p2o.host.slots import SLOTS, STAGE_OF


def missing_words(needs: Iterable[str], upstream: Sequence[Offer]) -> list[tuple[str, Offer]]:
    """Return the needed words that are not given, each with the method that would have to give it.

    `upstream` are the methods before: both extractors, the matcher, or the dataset.
    """
    missing = []
    by_kind = {offer.kind: offer for offer in upstream}
    for word in sorted(needs):
        if word.startswith("image-") and Kind.IMAGE_EXTRACTOR in by_kind:
            givers = [by_kind[Kind.IMAGE_EXTRACTOR]]
        elif word.startswith("cloud-") and Kind.CLOUD_EXTRACTOR in by_kind:
            givers = [by_kind[Kind.CLOUD_EXTRACTOR]]
        else:
            # What frames hold is the dataset's to give, all else the extractors'.
            givers = [o for o in upstream if (o.kind == Kind.DATASET) == (word in HELD)] or list(upstream)
        for giver in givers:
            # What a frame may hold is only known when it is read; a dataset that declares nothing may give anything.
            maybe = giver.kind == Kind.DATASET and (word in HELD or not giver.method.gives)
            open_yet = maybe and not ("dense" in giver.method.gives and word in LOST)
            given = not giver.method.gives.isdisjoint({word, *_ALSO.get(word, ())})
            if not given and not open_yet:
                missing.append((word, giver))
    return missing


HELD: dict[str, Callable[[Frame], object]] = {
    "right": lambda frame: frame.image.right,
    "depth": lambda frame: frame.image.depth_m,
    "rings": lambda frame: frame.cloud.ring,
    "intensity": lambda frame: frame.cloud.intensity,
    "time": lambda frame: frame.cloud.time_s,
    "twist": lambda frame: frame.twist,
    "sequence": lambda frame: frame.sequence or None,
    "frame-time": lambda frame: frame.time_s,
    "lidar-pose": lambda frame: frame.lidar_world_from_lidar,
    "camera-pose": lambda frame: frame.camera_world_from_camera,
    "targets": lambda frame: frame.targets or None,
}
"""The words for what a frame may hold, and where it holds it."""

_ALSO = {"objective": ("pairs", "residuals"), "residuals": ("pairs",)}
"""Words that stand for more: pairs are a least squares, and that has a cost, its robust sum."""

LOST = frozenset({"rings", "time", "twist"})
"""What a frame no longer holds once sweeps are joined in it."""

_OPTION_OF = {slot.kind: slot.option for slot in SLOTS}


def misfit_of(offers: Mapping[str, Offer], held: frozenset[str] | None = None) -> tuple[str, Offer, Offer] | None:
    """Return the first word that is needed and not given: the word, who should give it, who needs it.

    `held` are the words that the frames are known to hold, once one has been read.
    """
    extractors = [offers[stage] for stage in ("extractor", "cloud") if stage in offers]
    data = [offers["data"]] if "data" in offers else []
    if data and "accumulate" in offers:
        data = [_joined(data[0], offers["accumulate"])]
    upstream = {
        "accumulate": [offers["data"]] if "data" in offers else [],
        "extractor": data,
        "cloud": data,
        "calibrator": data,
        "matcher": extractors,
        "init": [*extractors, *data],
        "solver": [offers["matcher"]] if "matcher" in offers else [],
    }
    for stage, before in upstream.items():
        if stage not in offers or not before:
            continue
        needs = frozenset(offers[stage].method.needs)
        if stage == "init" and not data:
            # Frames are not known yet: what they hold is asked when they are.
            needs -= HELD.keys()
        for word, giver in missing_words(needs, before):
            return word, giver, offers[stage]
        if held is not None and before[-1].kind == Kind.DATASET:
            for word in sorted((needs & HELD.keys()) - held - before[-1].method.gives):
                return word, before[-1], offers[stage]
    return None


def _joined(data: Offer, accumulator: Offer) -> Offer:
    """Return what the frames of a dataset are once their sweeps are joined."""
    gives = (data.method.gives - LOST) | accumulator.method.gives
    return replace(data, method=replace(data.method, gives=gives))


def way_out(offers: Mapping[str, Offer], registry: Registry, user: Offer, held: frozenset[str] | None = None) -> str:
    """Return what to write instead of the method `user` so that everything fits, or that there is nothing."""
    stage = STAGE_OF[user.kind]
    fitting = [o for o in registry.of_kind(user.kind) if misfit_of({**offers, stage: o}, held) is None]
    if not fitting:
        return f"no installed {user.kind} fits in its place (`p2o methods --matrix` shows what does)"
    names = [offer.name for offer in fitting[:4]]
    if user.kind == Kind.IMAGE_EXTRACTOR:
        names = [f"{name}/{offers['cloud'].name}" for name in names]
    elif user.kind == Kind.CLOUD_EXTRACTOR:
        names = [f"{offers['extractor'].name}/{name}" for name in names]
    return f"try {_OPTION_OF[user.kind]} {' or '.join(names)}"


def check_fit(offers: Mapping[str, Offer], registry: Registry) -> None:
    """Raise InputError where a method needs what nothing before it gives, with what would fit instead."""
    misfit = misfit_of(offers)
    if misfit is not None:
        word, giver, user = misfit
        raise InputError(f"{giver.name} gives no {word}; {user.name} needs it", hint=way_out(offers, registry, user))
