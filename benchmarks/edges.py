r"""How good are image edges? Scores against exact labels, and agreement with LiDAR edges at the true pose.

    python benchmarks/edges.py --data "synthetic:?scenes=24&seed=101" --extractor stereo,canny
    python benchmarks/edges.py --against lidar --data kitti-raw:PATH --frames @benchmarks/splits.json#test \
        --extractor stereo,canny

Exact labels need data with depth. Extractors are names of `p2o methods`, with options after a question mark where they
differ (`stereo?min_confidence=0.3`); `--set extractor.FIELD=VALUE` sets a field of all of them. Edges of leaves are
ignored unless `--leaves true`. What the figures mean is written in p2o/edge_scores.py.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from edge_scores import (
    NEAR_PX,
    STRICT_PX,
    AgainstLidar,
    EdgeTruth,
    Judged,
    against_lidar,
    edge_truth,
    judge_boundary,
    judge_sides,
    precision_recall,
    score,
    seen_by_camera,
    together,
    within,
)
from p2o import SIDES, CloudExtractor, Frame, ImageEdges, ImageExtractor, InputError, P2OError, Side, View
from p2o.arrays import Bool, Float
from p2o.frames.selection import select
from p2o.host.method import Kind
from p2o.host.registry import Registry
from p2o.options import validated
from p2o.problems.agreement import agreement
from p2o.run.recipe import Part, open_dataset
from p2o.run.words import parse_settings, split_data
from p2o_sim import synthetic
from reliability import Reliability, draw_reliability, reliability

BOUNDARY_SHARE = 0.0075
"""Reach of the papers' scores as a share of the image diagonal."""


@dataclass(frozen=True)
class Extractor:
    """An image extractor with the text that asked for it."""

    text: str
    extract: ImageExtractor
    directed: bool


@dataclass
class Exact:
    """What is collected for one extractor over all images, to be printed at the end."""

    any_direction: list[Judged] = field(default_factory=list)
    directed: list[Judged] = field(default_factory=list)
    pixels: list[Judged] = field(default_factory=list)
    sides: dict[Side, list[Judged]] = field(default_factory=lambda: defaultdict(list))
    weight: list[Float] = field(default_factory=list)
    right: list[Bool] = field(default_factory=list)
    edges: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)

    def add(self, edges: ImageEdges, truth: EdgeTruth, diagonal_px: float, seconds: float) -> None:
        plain, directed = judge_boundary(edges, truth, BOUNDARY_SHARE * diagonal_px)
        self.any_direction.append(plain)
        self.directed.append(directed)
        self.pixels.append(judge_boundary(edges, truth, STRICT_PX)[0])
        for side, judged in judge_sides(edges, truth).items():
            self.sides[side].append(judged)
        right = within(edges, truth.edges)
        counts = right | ~within(edges, truth.ignored)
        self.weight.append(edges.weight[counts])
        self.right.append(right[counts])
        self.edges.append(len(edges))
        self.seconds.append(seconds)


@dataclass
class Lidar:
    """What is collected for one extractor over all frames, to be printed at the end."""

    parts: list[AgainstLidar] = field(default_factory=list)
    chance: float = 0.0
    points: int = 0
    seconds: list[float] = field(default_factory=list)

    def add(self, view: View, frame: Frame, *, directed: bool, seconds: float) -> None:
        pose = frame.camera_from_lidar
        self.parts.append(against_lidar(view, pose, returns=frame.cloud.xyz))
        seen = seen_by_camera(view, pose)
        met = agreement([seen if directed else seen.without_sides()], pose)
        self.chance += met.chance * met.points
        self.points += met.points
        self.seconds.append(seconds)


def extractors(texts: str, options: Mapping[str, Any], registry: Registry) -> list[Extractor]:
    """Return the extractors of a text such as "stereo,canny?low=30"; options go to those that have such a field."""
    built, unused = [], set(options)
    for text in texts.split(","):
        name, _, query = text.strip().partition("?")
        offer = registry.find(Kind.IMAGE_EXTRACTOR, name)
        own = {key: value for key, value in options.items() if key in offer.method.options.model_fields}
        unused -= set(own)
        _, values = split_data(f"{name}:?{query}")
        part = Part(offer, validated(offer.method.options, {**own, **values}, name))
        built.append(Extractor(text.strip(), part.build(), "side" in offer.method.gives))
    if unused:
        raise InputError(f"no extractor has the option {sorted(unused)[0]}", where="--set", expected=texts)
    return built


def labelled(data: str, frames: str, registry: Registry, leaves: str) -> Iterator[tuple[Frame, EdgeTruth]]:
    """Yield frames with their exact edges; of simulated scenes with exact normals."""
    name, values = split_data(data)
    dataset = open_dataset(data, registry)
    options = validated(synthetic.SyntheticOptions, values, "data") if name == "synthetic" else None
    for index in select(dataset.names, frames, where="--frames", skipped=dataset.skipped):
        if options is None:
            frame = dataset[index]
            normals, masked = None, frame.image.masked
        else:
            view = synthetic.view(options, *divmod(index, options.frames_per_scene))
            frame, normals, masked = view.frame, view.rendered.normals, ~view.rendered.seen | view.rendered.foliage
        if frame.image.depth_m is None:
            raise InputError("the image has no depth", where=frame.name, expected="data with depth, such as synthetic:")
        mask = masked if leaves == "ignored" else None
        yield frame, edge_truth(frame.image.depth_m, frame.camera, normals=normals, masked=mask)


def timed(extractor: Extractor, frame: Frame) -> tuple[Any, float]:
    began = time.perf_counter()
    features = extractor.extract(frame.without_truth().image)
    return features, time.perf_counter() - began


def exact(arguments: argparse.Namespace, chosen: list[Extractor], registry: Registry) -> dict[str, Reliability]:
    results = {extractor.text: Exact() for extractor in chosen}
    count, true = 0, 0
    for frame, truth in labelled(arguments.data, arguments.frames, registry, arguments.leaves):
        count, true = count + 1, true + len(truth.edges)
        for extractor in chosen:
            features, seconds = timed(extractor, frame)
            edges = features.edges if features.edges is not None else ImageEdges.empty()
            diagonal = float(np.hypot(frame.camera.width, frame.camera.height))
            results[extractor.text].add(edges, truth, diagonal, seconds)
    print(f"\n{arguments.data}, {arguments.frames}: {count} images, {true / count:.0f} true edge points an image")
    print(
        f"\nEdge pixels within {BOUNDARY_SHARE} diagonals, one-to-one. Directed: precision of well directed pixels, "
        "recall of all (OPR); strict: recall of well directed ones, too.\n"
    )
    print("| extractor | points an image | any direction ODS / OIS / AP | directed ODS / OIS / AP | strict | s |")
    print("|---|---|---|---|---|---|")
    for extractor in chosen:
        r = results[extractor.text]
        cells = [_score(score(r.any_direction)), "no direction", "no direction"]
        if extractor.directed:
            cells[1:] = [_score(score(r.directed, r.any_direction)), _score(score(r.directed))]
        print(f"| {extractor.text} | {np.mean(r.edges):.0f} | {' | '.join(cells)} | {np.median(r.seconds):.2f} |")
    print(f"\nEdge points within {STRICT_PX:g} px of a true one of their own side, one-to-one: precision / recall.\n")
    print("| extractor | " + " | ".join(s.letter for s in SIDES) + " | all four | best F at | pixels, any direction |")
    print("|---|---|---|---|---|---|---|---|")
    for extractor in chosen:
        r = results[extractor.text]
        cells = ["no direction"] * 6
        if extractor.directed:
            cells = [_pair(*precision_recall(together(r.sides[side]))) for side in SIDES]
            images = [together(parts) for parts in zip(*(r.sides[side] for side in SIDES), strict=True)]
            best = score(images)
            cells += [
                _pair(*precision_recall(together(images))),
                f"{best.ods:.3f} = {_pair(best.precision, best.recall)} at {best.threshold:.2f}",
            ]
        print(f"| {extractor.text} | {' | '.join(cells)} | {_pair(*precision_recall(together(r.pixels)))} |")
    return tables(
        {e.text: (np.concatenate(r.weight), np.concatenate(r.right)) for e, r in _zip(chosen, results)}, arguments.bins
    )


def lidar(arguments: argparse.Namespace, chosen: list[Extractor], registry: Registry) -> dict[str, Reliability]:
    offer = registry.find(Kind.CLOUD_EXTRACTOR, arguments.cloud)
    settings = parse_settings(arguments.set).get("cloud", {})
    sweep_edges: CloudExtractor = Part(offer, validated(offer.method.options, settings, "cloud")).build()
    dataset = open_dataset(arguments.data, registry)
    results = {extractor.text: Lidar() for extractor in chosen}
    frames = select(dataset.names, arguments.frames, where="--frames", skipped=dataset.skipped)
    for index in frames:
        frame = dataset[index]
        if frame.camera_from_lidar is None:
            raise InputError("the frame has no true pose", where=frame.name, expected="data with a known extrinsic")
        cloud = sweep_edges(frame.cloud)
        for extractor in chosen:
            features, seconds = timed(extractor, frame)
            view = View(frame.name, frame.camera, features, cloud)
            results[extractor.text].add(view, frame, directed=extractor.directed, seconds=seconds)
    joined = {extractor.text: AgainstLidar.joined(results[extractor.text].parts) for extractor in chosen}
    print(f"\n{arguments.data}, {arguments.frames}: {len(frames)} frames, against {arguments.cloud}")
    print(
        f"\nShare of LiDAR edges with an image edge of their side within {NEAR_PX:g} px (recall; chance: of points "
        "scattered over the same rows), and of image edges that the LiDAR could see with such a LiDAR edge (precision)."
        "\n"
    )
    letters = " | ".join(s.letter for s in SIDES)
    print(f"| extractor | | all | {letters} | chance | edges | s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for extractor in chosen:
        r, both = results[extractor.text], joined[extractor.text]
        cells = [_share(both.found)] + [_share(both.of(side).found) for side in SIDES]
        chance = f"{r.chance / r.points:.3f}" if r.points else "-"
        cells += [chance, str(len(both.found)), f"{np.median(r.seconds):.2f}"]
        print(f"| {extractor.text} | recall | {' | '.join(cells)} |")
        cells = [_share(both.confirmed)]
        cells += [_share(both.of(side).confirmed) if extractor.directed else "no direction" for side in SIDES]
        print(f"| {extractor.text} | precision | {' | '.join(cells)} | | {len(both.confirmed)} | |")
    print(
        "\nLiDAR minus nearest image edge of its side at the true pose, pairs nearer than 5 px, x for L and R, y for "
        "U and B, right and down are positive: mean / median px (pairs).\n"
    )
    print(f"| extractor | {letters} |")
    print("|---|---|---|---|---|")
    for extractor in chosen:
        both = joined[extractor.text]
        print(f"| {extractor.text} | {' | '.join(_offset(both.of(side).offset_px) for side in SIDES)} |")
    return tables({name: (both.weight, both.confirmed) for name, both in joined.items()}, arguments.bins)


def tables(points: Mapping[str, tuple[Float, Bool]], bins: int) -> dict[str, Reliability]:
    """Return and print the reliability of every extractor whose edges differ in confidence."""
    kept = {
        name: reliability(np.minimum(weight, 1), right, bins)
        for name, (weight, right) in points.items()
        if len(np.unique(weight)) > 1
    }
    if not kept:
        print("\nNo extractor gives confidences.")
        return kept
    first = next(iter(kept.values()))
    print("\nReliability: mean confidence > share confirmed (edge points).\n")
    print("| confidence | " + " | ".join(kept) + " |")
    print("|" + "---|" * (len(kept) + 1))
    for number in range(bins):
        cells = [
            f"{t.confidence[number]:.2f} > {t.share[number]:.2f} ({t.count[number]})" if t.count[number] else "-"
            for t in kept.values()
        ]
        print(f"| {first.low[number]:.2f} to {first.high[number]:.2f} | {' | '.join(cells)} |")
    print("| expected calibration error | " + " | ".join(f"{t.expected_error:.3f}" for t in kept.values()) + " |")
    return kept


def _zip(chosen: list[Extractor], results: Mapping[str, Any]) -> Iterator[tuple[Extractor, Any]]:
    return ((extractor, results[extractor.text]) for extractor in chosen)


def _score(s: Any) -> str:
    return f"{s.ods:.3f} / {s.ois:.3f} / {s.ap:.3f}"


def _pair(precision: float, recall: float) -> str:
    return f"{precision:.3f} / {recall:.3f}"


def _share(hits: Bool) -> str:
    return f"{hits.mean():.3f}" if len(hits) else "-"


def _offset(offset: Float) -> str:
    known = offset[np.isfinite(offset)]
    return f"{known.mean():+.2f} / {np.median(known):+.2f} ({len(known)})" if len(known) else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", required=True, help="DATASET:PATH as for p2o run")
    parser.add_argument("--frames", default="all", help="as for p2o run")
    parser.add_argument("--extractor", default="stereo,canny", help="image extractors, joined by commas")
    parser.add_argument(
        "--against", choices=["exact", "lidar"], default="exact", help="what the edges are held against"
    )
    parser.add_argument("--cloud", default="rings", help="cloud extractor of --against lidar")
    parser.add_argument("--set", nargs="*", default=[], metavar="STAGE.FIELD=VALUE", help="extractor.* or cloud.*")
    parser.add_argument("--leaves", choices=["ignored", "true"], default="ignored", help="edges of leaves and masks")
    parser.add_argument("--bins", type=int, default=10, help="bins of the reliability table")
    parser.add_argument("--draw", help="write the reliability diagram to this PNG")
    arguments = parser.parse_args()
    try:
        registry = Registry.load()
        chosen = extractors(arguments.extractor, parse_settings(arguments.set).get("extractor", {}), registry)
        measure = exact if arguments.against == "exact" else lidar
        found = measure(arguments, chosen, registry)
        if arguments.draw:
            draw_reliability(found, arguments.draw)
    except P2OError as problem:
        raise SystemExit(str(problem)) from problem


if __name__ == "__main__":
    main()
