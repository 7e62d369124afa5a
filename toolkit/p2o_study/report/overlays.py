"""Draw overlays of sweeps before and after calibration from the data of the user; stores contain no images."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from p2o.draw.image_uri import jpeg_uri
from p2o.draw.overlay import draw_cloud
from p2o.errors import InputError
from p2o.run.recipe import open_dataset
from p2o.run.words import data_by_name, split_data

from p2o_study.row import Row, canonical, frame_digest
from p2o_study.statistics import error_rank
from p2o_study.summary import Summary
from p2o_study.worker import Identity, content_digests

if TYPE_CHECKING:
    from p2o.frames.frame import Frame
    from p2o.host.guard import GuardedDataset
    from p2o.host.registry import Registry

Wanted = tuple[Row, str]
"""One frame of one run to draw."""


@dataclass
class OverlayImages:
    """JPEG images as data URIs without duplicates: `of` maps (key of the run, frame) to indices (before, after)."""

    uris: Sequence[str] = ()
    of: Mapping[tuple[str, str], tuple[int, int]] = field(default_factory=dict)


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
    # Rows may differ in options of the data.
    by_data: dict[tuple[str, str], list[Wanted]] = {}
    for run, frame in wanted:
        by_data.setdefault((run.dataset, canonical(run.case.options)), []).append((run, frame))
    datasets = {key: _opened(text_of[key[0]], own[0][0], registry) for key, own in by_data.items()}
    for key, own in by_data.items():
        _check_names(own, text_of[key[0]], datasets[key].names)
    numbers: dict[str, int] = {}
    of: dict[tuple[str, str], tuple[int, int]] = {}
    for key, own in by_data.items():
        for name in dict.fromkeys(frame for _, frame in own):
            tell(name, len(of), len(wanted))
            index = datasets[key].names.index(name)
            read: Frame = datasets[key][index]
            identity = Identity.of(datasets[key], index, None)
            digests = content_digests(read) if identity is None else identity.content_digests
            for run in (run for run, frame in own if frame == name):
                known = next(known for known in run.case.frames if known.name == name)
                if known.content != frame_digest(digests, read.camera_from_lidar):
                    hint = "give the data of the study, run the study again, or leave out --data"
                    raise InputError("this frame differs from that of the study", where=name, hint=hint)
                poses = [pose for pose in (run.case.start, run.pose) if pose is not None]
                images = (draw_cloud(read.image.rgb, read.cloud, read.camera, pose) for pose in poses)
                # Rows with the same frame and initial guess share the overlay before.
                before, after = (numbers.setdefault(jpeg_uri(image), len(numbers)) for image in images)
                of[run.key, name] = before, after
    return OverlayImages(list(numbers), of)


def _opened(text: str, run: Row, registry: Registry) -> GuardedDataset:
    """Return the dataset in `text`: that of the study has the options of the run, possibly at another path."""
    name, options = split_data(text)
    if name == run.case.data:
        options = {**run.case.options, **options}
    return open_dataset(f"{name}:", registry, options)


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
