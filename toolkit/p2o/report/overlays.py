"""Pictures of runs before and after calibration, drawn anew from the user's own data: no store keeps pictures."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from p2o.arrays import Float, UInt8
from p2o.errors import InputError, P2OError
from p2o.frames.scale import image_at_scale
from p2o.host.slots import Kind
from p2o.report.one_file import jpeg_uri
from p2o.report.summary import Summary
from p2o.report.worst import badness
from p2o.run.assembly import Assembly
from p2o.run.part import Part
from p2o.run.recipe import Recipe
from p2o.run.words import data_by_name, split_data
from p2o.study.store import StoredRow
from p2o.work.cache import FeatureCache, content_hash, features_key

if TYPE_CHECKING:
    from p2o.frames.frame import Frame
    from p2o.host.guard import GuardedDataset
    from p2o.host.registry import Registry
    from p2o.run.joined import JoinedFrames


@dataclass(frozen=True)
class Wanted:
    """One frame of one run that is to be drawn."""

    run: StoredRow
    frame: str


@dataclass
class Pictures:
    """JPEGs as data URIs, each once: `of` maps (key of the run, frame) to the numbers of before and after."""

    uris: list[str] = field(default_factory=list)
    of: dict[tuple[str, str], tuple[int, int]] = field(default_factory=dict)

    def add(self, wanted: Wanted, before: UInt8, after: UInt8) -> None:
        """Add the pictures of a run, (H, W, 3) each."""
        self.of[wanted.run.key, wanted.frame] = (self._number(before), self._number(after))

    def _number(self, picture: UInt8) -> int:
        uri = jpeg_uri(picture)
        # Rows that share frame, start and extractor share the picture before.
        if uri not in self._numbers:
            self._numbers[uri] = len(self.uris)
            self.uris.append(uri)
        return self._numbers[uri]

    _numbers: dict[str, int] = field(default_factory=dict, repr=False)


def chosen(summary: Summary, most: int) -> list[Wanted]:
    """Return what to draw: for each row at most `most` frames, the worst first, each with its worst seed."""
    found = []
    for group in summary.groups:
        for runs in group.runs.values():
            # The first is that of `worst_run`: of several that are as bad the first.
            ranked = sorted((run for run in runs if run.estimate is not None), key=badness, reverse=True)
            worst: dict[str, StoredRow] = {}
            for run in ranked:
                for frame in run.frames:
                    worst.setdefault(frame, run)
            found += [Wanted(run, frame) for frame, run in list(worst.items())[:most]]
    return found


def draw_all(
    summaries: Sequence[Summary],
    data: Sequence[str],
    most: int,
    registry: Registry,
    tell: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Pictures:
    """Return the pictures of the chosen frames of all studies from data such as ["kitti-raw:PATH"].

    With several datasets each text is NAME=DATASET:PATH, where NAME is what the studies call it. `tell` is told the
    frame, how many pictures are drawn, and of how many. Raises UnknownNameError for a dataset that no study has,
    InputError where it is not said which one is meant, where frames are missing from the data, or are not those that
    the study saw.
    """
    runs = [run for s in summaries for group in s.groups for some in group.runs.values() for run in some]
    text_of = data_by_name(data, sorted({run.dataset for run in runs}), "the studies")
    wanted = [w for summary in summaries for w in chosen(summary, most) if w.run.dataset in text_of]
    for name, text in text_of.items():
        own = [w for w in wanted if w.run.dataset == name]
        if own:
            _check_names(own, text, _opened(text, own[0].run, registry).dataset.names)
    pictures = Pictures()
    done = 0
    # One recipe after the other, frame by frame: a frame is read and its features are extracted once.
    for own in _by_recipe(wanted):
        text = text_of[own[0].run.dataset]
        source = _opened(text, own[0].run, registry)
        _check_names(own, text, source.dataset.names)
        for name in dict.fromkeys(w.frame for w in own):
            tell(name, done, len(wanted))
            frame = source.frame(name)
            for w in own:
                if w.frame == name:
                    done += 1
                    _check_content(w, frame)
                    pictures.add(w, *source.drawn(w.run, frame))
    return pictures


def _by_recipe(wanted: Sequence[Wanted]) -> Iterable[list[Wanted]]:
    """Return those together that are drawn from the same dataset and recipe, whatever their frames and starts."""
    found: dict[str, list[Wanted]] = {}
    for w in wanted:
        recipe = {key: value for key, value in w.run.recipe.items() if key not in ("seed", "perturb", "frames")}
        found.setdefault(json.dumps([w.run.dataset, recipe], sort_keys=True), []).append(w)
    return found.values()


@dataclass(frozen=True)
class _Source:
    """The frames of one recipe, and its methods: what they or their witness see is drawn."""

    dataset: GuardedDataset | JoinedFrames
    assembly: Assembly

    def frame(self, name: str) -> Frame:
        frame: Frame = self.dataset[self.dataset.names.index(name)]
        return frame

    def drawn(self, run: StoredRow, frame: Frame) -> tuple[UInt8, UInt8]:
        """Return the pictures at the start and at the estimate of a run."""
        before, after = run.start, run.estimate
        assert after is not None
        draw = partial(self._at, frame)
        return draw(after if before is None else before), draw(after)

    def _at(self, frame: Frame, camera_from_lidar: Float) -> UInt8:
        """Return edges of both sensors at a pose; the sweep where there are none, or an extractor refuses."""
        from p2o.draw import overlay

        with contextlib.suppress(P2OError):
            view = self.assembly.view(frame)
            if view is not None:
                view = view.as_seen_from(camera_from_lidar)
                if len(view.image_edges) or len(view.cloud_edges):
                    return overlay.draw(
                        image_at_scale(frame.image).rgb,
                        view.image_edges,
                        view.cloud_edges,
                        view.camera,
                        camera_from_lidar,
                    )
        return overlay.draw_cloud(frame.image.rgb, frame.cloud, frame.camera, camera_from_lidar)


def _opened(text: str, run: StoredRow, registry: Registry) -> _Source:
    """Return where the frames of a run are, and what it extracts from them."""
    recipe = dict(run.recipe)
    name, said = split_data(text)
    options = {stage: dict(values) for stage, values in recipe.get("options", {}).items()}
    if name == split_data(recipe.get("data") or text)[0]:
        # The frames of the study, wherever they lie by now.
        said = {**options.get("data", {}), **said}
    options["data"] = said
    plan = Recipe.of(**{**recipe, "data": f"{name}:", "options": options}).resolve(registry)
    return _Source(plan.dataset(), Assembly.of(plan.parts, plan.pipeline, _kept))


def _kept(part: Part) -> Any:
    """Return the stage of a part; an extractor looks first where studies keep features, and is built where need be."""
    if part.offer.kind not in (Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR):
        return part.build()
    features, extractor = FeatureCache.of_user(), cache(part.build)

    def find(data: Any, /) -> Any:
        kept = features.get(features_key(part, content_hash(data)), part.offer)
        return extractor()(data) if kept is None else kept.features

    return find


def _check_names(wanted: Sequence[Wanted], text: str, there: Sequence[str]) -> None:
    absent = list(dict.fromkeys(w.frame for w in wanted if w.frame not in there))
    if absent:
        frames, name = len({w.frame for w in wanted}), wanted[0].run.dataset
        raise InputError(
            f"{len(absent)} of {frames} frames of dataset '{name}' are not in these data",
            where=f"--data {text}",
            expected=f"{absent[0]}{', ...' if len(absent) > 1 else ''}",
            got=f"{len(there)} frames such as {there[0]}" if there else "no frames",
            hint="give the data that the study ran on, or leave out --data",
        )


def _check_content(wanted: Wanted, frame: Frame) -> None:
    known: Any = wanted.run.inputs.get(wanted.frame, {})
    for part, value in (("image", frame.image), ("cloud", frame.cloud)):
        if part in known and known[part] != content_hash(value):
            raise InputError(
                f"the {part} of this frame is not the one that the study saw",
                where=wanted.frame,
                hint="give the data that the study ran on, run the study again, or leave out --data",
            )
