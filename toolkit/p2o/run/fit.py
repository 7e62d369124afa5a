"""Check compatibility: the content that methods need and give, and the content of frames."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from p2o.errors import InputError
from p2o.frames.frame import Frame
from p2o.host.method import Kind
from p2o.host.registry import Offer, Registry
from p2o.host.slots import EXTRACTORS, SLOT_OF
from p2o.run.presets import presets


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
            # The dataset gives the content of frames, the extractors give all other content.
            givers = [o for o in upstream if (o.kind == Kind.DATASET) == (word in FRAME_CONTENT)] or list(upstream)
        for giver in givers:
            # Optional content of a frame is known only after reading; a dataset without a declaration may give any.
            maybe = giver.kind == Kind.DATASET and (word in FRAME_CONTENT or not giver.method.gives)
            open_yet = maybe and not ("dense" in giver.method.gives and word in LOST)
            given = not giver.method.gives.isdisjoint({word, *_ALSO.get(word, ())})
            if not given and not open_yet:
                missing.append((word, giver))
    return missing


FRAME_CONTENT: dict[str, Callable[[Frame], object]] = {
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
"""Names of the optional content of a frame, each with a function that reads it from the frame."""


def contents_of(frame: Frame) -> frozenset[str]:
    """Return the names of the optional content that a frame has."""
    return frozenset(word for word, find in FRAME_CONTENT.items() if find(frame) is not None)


_ALSO = {"objective": ("pairs", "residuals"), "residuals": ("pairs",)}
"""Names that imply others: pairs are a least-squares problem, whose robust sum is a cost."""

LOST = frozenset({"rings", "time", "twist"})
"""Content that an accumulated frame does not have."""


def misfit_of(offers: Mapping[str, Offer], contents: frozenset[str] | None = None) -> tuple[str, Offer, Offer] | None:
    """Return the first word that is needed and not given: the word, who should give it, who needs it.

    `contents` are the words that the frames are known to hold, once one has been read.
    """
    extractors = [offers[stage] for stage in EXTRACTORS if stage in offers]
    data = [offers["data"]] if "data" in offers else []
    if data and "accumulate" in offers:
        gives = (data[0].method.gives - LOST) | offers["accumulate"].method.gives
        data = [replace(data[0], method=replace(data[0].method, gives=gives))]
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
            # Frames are not known yet: their content is checked when they are read.
            needs -= FRAME_CONTENT.keys()
        for word, giver in missing_words(needs, before):
            return word, giver, offers[stage]
        if contents is not None and before[-1].kind == Kind.DATASET:
            for word in sorted((needs & FRAME_CONTENT.keys()) - contents - before[-1].method.gives):
                return word, before[-1], offers[stage]
    return None


def suggest_alternative(
    offers: Mapping[str, Offer], registry: Registry, user: Offer, contents: frozenset[str] | None = None
) -> str:
    """Suggest a compatible replacement of the method `user`, or state that there is none."""
    slot = SLOT_OF[user.kind]
    fitting = [o for o in registry.of_kind(user.kind) if misfit_of({**offers, slot.stage: o}, contents) is None]
    if not fitting:
        return f"no installed {user.kind} fits in its place (`p2o methods --matrix` shows what does)"
    beside = {stage: offer.name for stage, offer in offers.items()}
    names = [slot.spec(offer.name, beside) for offer in fitting[:4]]
    return f"try {slot.option} {' or '.join(names)}"


def check_fit(offers: Mapping[str, Offer], registry: Registry) -> None:
    """Raise InputError with alternatives if a method needs content that no previous stage gives."""
    misfit = misfit_of(offers)
    if misfit is not None:
        word, giver, user = misfit
        hint = suggest_alternative(offers, registry, user)
        matcher = offers["matcher"].name if "matcher" in offers else ""
        if (preset := presets(registry).get(matcher)) is not None:
            hint += f"; {matcher} is published with these: --method {matcher}, which stands for {preset}"
        raise InputError(f"{giver.name} gives no {word}; {user.name} needs it", hint=hint)
