"""Draw overlays of runs before and after calibration from the data of the user; stores contain no images."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from p2o.arrays import Float, UInt8
from p2o.cache import FeatureCache, content_hash
from p2o.draw.image_uri import jpeg_uri
from p2o.errors import InputError, P2OError
from p2o.frames.scale import image_at_scale
from p2o.host.slots import Kind
from p2o.run.assembly import Assembly
from p2o.run.part import Part
from p2o.run.recipe import Recipe
from p2o.run.words import data_by_name, split_data

from p2o_study.damage import Damage, split_options
from p2o_study.keys import features_key
from p2o_study.row import Row, frame_digest
from p2o_study.statistics import error_rank
from p2o_study.summary import Summary
from p2o_study.worker import Identity, content_digests

if TYPE_CHECKING:
    from p2o.frames.frame import Frame
    from p2o.host.guard import GuardedDataset
    from p2o.host.registry import Registry
    from p2o.run.joined import JoinedFrames


Wanted = tuple[Row, str]
"""One frame of one run to draw."""


@dataclass
class OverlayImages:
    """JPEG images as data URIs without duplicates: `of` maps (key of the run, frame) to indices (before, after)."""

    uris: list[str] = field(default_factory=list)
    of: dict[tuple[str, str], tuple[int, int]] = field(default_factory=dict)


def chosen(summary: Summary, most: int) -> list[Wanted]:
    """Select for each row at most `most` frames, the worst first, each with its worst seed."""
    requests = []
    for group in summary.groups:
        for runs in (measured.rows for measured in group.measured):
            worst: dict[str, Row] = {}
            for run in sorted(runs, key=error_rank, reverse=True):
                if len(worst) >= most:
                    break
                # The estimate of a rig is the pose of the camera of the first frame.
                shown = run.frames[:1] if run.case.rig else run.frames
                for frame in shown if run.pose is not None else ():
                    worst.setdefault(frame, run)
            requests += [(run, frame) for frame, run in list(worst.items())[:most]]
    return requests


def draw_all(
    summaries: Sequence[Summary],
    data: Sequence[str],
    most: int,
    registry: Registry,
    tell: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> OverlayImages:
    """Return the overlays of the selected frames of all studies from data such as ["kitti-raw:PATH"].

    With several datasets each text is NAME=DATASET:PATH with the NAME in the studies. `tell` receives the frame, the
    number of finished overlays and their total. Raises UnknownNameError for an unknown dataset, InputError if NAME is
    missing but needed, or if frames are missing or differ from those of the study.
    """
    runs = [run for summary in summaries for run in summary.rows]
    text_of = data_by_name(data, sorted({run.dataset for run in runs}), "the studies")
    wanted = [(run, frame) for one in summaries for run, frame in chosen(one, most) if run.dataset in text_of]
    for name, text in text_of.items():
        if own := [(run, frame) for run, frame in wanted if run.dataset == name]:
            _check_names(own, text, _opened(text, own[0][0], registry).dataset.names)
    # By recipe, then frame, so that each frame is read and its features are extracted once.
    by_recipe: dict[tuple[str, int], list[Wanted]] = {}
    for run, frame in wanted:
        by_recipe.setdefault((run.dataset, id(run.method)), []).append((run, frame))
    numbers: dict[str, int] = {}
    images, done = OverlayImages(), 0
    for (dataset, _), own in by_recipe.items():
        source = _opened(text_of[dataset], own[0][0], registry)
        _check_names(own, text_of[dataset], source.dataset.names)
        for name in dict.fromkeys(frame for _, frame in own):
            tell(name, done, len(wanted))
            read: Frame = source.dataset[source.dataset.names.index(name)]
            for run in (run for run, frame in own if frame == name):
                done += 1
                # Rows with the same frame, initial guess and extractor share the overlay before.
                before, after = (numbers.setdefault(jpeg_uri(one), len(numbers)) for one in source.drawn(run, read))
                images.of[run.key, name] = before, after
    images.uris.extend(numbers)
    return images


@dataclass(frozen=True)
class _Source:
    """The frames of one recipe and the methods whose features are drawn; `identity` returns that of a frame."""

    dataset: GuardedDataset | JoinedFrames
    identity: Callable[[int], Identity | None]
    assembly: Assembly
    damage: Damage

    def drawn(self, run: Row, frame: Frame) -> tuple[UInt8, UInt8]:
        """Return the overlays at the initial guess and at the estimate of a run.

        Raises InputError if the frame differs from that of the run.
        """
        identity = self.identity(self.dataset.names.index(frame.name))
        digests = content_digests(frame) if identity is None else identity.content_digests
        known = next(known for known in run.case.frames if known.name == frame.name)
        if known.content != frame_digest(digests, frame.camera_from_lidar):
            hint = "give the data of the study, run the study again, or leave out --data"
            raise InputError("this frame differs from that of the study", where=frame.name, hint=hint)
        assert run.pose is not None
        assert run.case.start is not None
        return self._at(frame, run.case.start), self._at(frame, run.pose)

    def _at(self, frame: Frame, camera_from_lidar: Float) -> UInt8:
        """Draw edges of both sensors at a pose, or the sweep if there are none or an extractor raises."""
        from p2o.draw import overlay

        with contextlib.suppress(P2OError):
            view = self.assembly.view(frame)
            if view is not None:
                image = self.damage.image_features(view.image, frame.camera, frame.name)
                view = replace(view, image=image).as_seen_from(camera_from_lidar)
                if len(view.image_edges) or len(view.cloud_edges):
                    rgb = image_at_scale(frame.image).rgb
                    return overlay.draw(rgb, view.image_edges, view.cloud_edges, view.camera, camera_from_lidar)
        return overlay.draw_cloud(frame.image.rgb, frame.cloud, frame.camera, camera_from_lidar)


def _opened(text: str, run: Row, registry: Registry) -> _Source:
    """Return the dataset and the methods of a run, reading frames from the data in `text`."""
    name, data_options = split_data(text)
    options, damage = split_options(run.method.options, run.seed)
    if name == run.case.data:
        # The dataset of the study, possibly at another path.
        data_options = {**run.case.options, **data_options}
    words = {**run.method.words, "data": f"{name}:", "options": {**options, "data": data_options}}
    plan = Recipe.of(**words).resolve(registry)
    dataset: GuardedDataset = plan.parts["data"].build()

    def identity(index: int) -> Identity | None:
        return Identity.of(dataset, index, plan.parts.get("accumulate"))

    return _Source(plan.joined(dataset), identity, Assembly.of(plan.parts, plan.pipeline, _kept), damage)


def _kept(part: Part) -> Any:
    """Return the stage of a part; an extractor reads cached features and is built on demand."""
    if part.offer.kind not in (Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR):
        return part.build()
    features, extractor = FeatureCache.of_user(), cache(part.build)

    def find(data: Any, /) -> Any:
        kept = features.get(features_key(part, content_hash(data)), part.offer)
        return extractor()(data) if kept is None else kept.features

    return find


def _check_names(wanted: Sequence[Wanted], text: str, names: Sequence[str]) -> None:
    frames = dict.fromkeys(frame for _, frame in wanted)
    if absent := [frame for frame in frames if frame not in names]:
        name = wanted[0][0].dataset
        raise InputError(
            f"{len(absent)} of {len(frames)} frames of dataset '{name}' are missing from the data",
            where=f"--data {text}",
            expected=f"{absent[0]}{', ...' if len(absent) > 1 else ''}",
            got=f"{len(names)} frames such as {names[0]}" if names else "no frames",
            hint="give the data of the study, or leave out --data",
        )
