"""Matchers of third parties are trusted where their results are right, whatever kind of problem they pose."""

from __future__ import annotations

from pathlib import Path

import p2o
import pytest
from p2o.host.method import Kind
from p2o.run.outcome import Run
from p2o_testing.new_plugin import NewPlugin

from tests.pages import python_blocks

STREETS = "synthetic:?scenes=4&seed=9&place=street&right=false&width_px=512&height_px=156"
HOOK = """

@p2o.hookimpl
def p2o_matchers():
    yield p2o.Method(
        name="tried", build=build, options=Options, summary="Tried here.", needs=NEEDS, gives={GIVES},
    )
"""
SOFT = '''
"""Soft assignment: each LiDAR edge to the mean of the image edges of its side, weighted by their distance."""

import numpy as np
import p2o
from p2o.solving import LeastSquares
from scipy.spatial import cKDTree


class Options(p2o.Options):
    width_px: float = p2o.field(3.0, gt=0, le=50, help="Standard deviation of the weights.")


class Soft(LeastSquares):
    huber, far = 2.0, 100.0

    def __init__(self, views, pose, reach_px, width_px):
        self.parts, frame = [], [np.zeros(0, int)]
        for number, view in enumerate(views):
            uv = view.camera.project(p2o.se3.apply(pose, view.cloud_edges.xyz))
            inside = view.camera.in_image(uv)
            for side in p2o.SIDES:
                index = view.image_edges.index.get(side)
                rows = np.flatnonzero(inside & (view.cloud_edges.side == side))
                if index is None or len(index) < 8 or not len(rows):
                    continue
                target = view.image_edges.uv[index]
                distance, near = cKDTree(target).query(uv[rows], k=8)
                kept = distance[:, 0] <= reach_px
                weight = np.exp(-0.5 * ((distance - distance[:, :1]) / width_px) ** 2)
                mean = (weight[..., None] * target[near]).sum(axis=1) / weight.sum(axis=1)[:, None]
                axis = 0 if side in (p2o.Side.LEFT, p2o.Side.RIGHT) else 1
                self.parts.append((view.camera, view.cloud_edges.xyz[rows[kept]], mean[kept, axis], axis))
                frame.append(np.full(int(kept.sum()), number))
        self.frame = np.concatenate(frame)
        self.weight = np.ones(len(self.frame))

    def residuals(self, pose):
        rows = [np.zeros((*np.shape(pose)[:-2], 0))]
        for camera, xyz, target, axis in self.parts:
            rows.append(camera.project(p2o.se3.apply(pose, xyz))[..., axis] - target)
        return np.concatenate(rows, axis=-1)


def build(options):
    return lambda views, pose, reach_px: Soft(views, pose, reach_px, options.width_px)


NEEDS, GIVES = {"image-edges", "cloud-edges", "side"}, "residuals"
'''


def plugin(kind: str) -> str:
    """Return the source of a plugin with one matcher."""
    if kind == "template":
        return NewPlugin("tried-matcher", Kind.MATCHER).files()["src/tried_matcher/plugin.py"]
    if kind == "residuals":
        return SOFT + HOOK
    [code] = [block.text for block in python_blocks("docs/plugins.md") if "assemble(views, pairs" in block.text]
    return code + '\n\nOptions, NEEDS, GIVES = PairingOptions, {"image-edges", "cloud-edges", "side"}, "pairs"\n' + HOOK


def _run(source: str, folder: Path) -> Run:
    file = folder / "tried_plugin.py"
    file.write_text(source, encoding="utf-8")
    registry = p2o.Registry.load(extra_files=[file])
    [offer] = [
        offer for offer in registry.of_kind(Kind.MATCHER) if offer.dist == "tried_plugin" or "tried" in offer.name
    ]
    solver = "lm" if "objective" not in offer.method.gives else "coordinate"
    return p2o.calibrate(
        STREETS,
        extractor="depth/rings",
        matcher=offer.full_name,
        solver=solver,
        perturb="1deg 0.1m",
        joint=True,
        registry=registry,
    )


@pytest.mark.parametrize("kind", ["template", "residuals", "pairs"])
def test_a_matcher_of_a_third_party_is_trusted_on_four_streets_and_its_predicted_error_covers_it(
    kind: str, tmp_path: Path
) -> None:
    [row] = _run(plugin(kind), tmp_path).rows
    assert row.error is not None
    assert row.error.rotation_deg < 0.25
    assert row.error.translation_m < 0.05
    assert row.result.verdict.trusted, row.result.verdict
    accuracy = row.result.accuracy
    if kind != "template":
        assert accuracy is not None
        assert row.error.rotation_deg < accuracy.rotation_deg_95 < 0.6
        assert row.error.translation_m < accuracy.translation_m_95 < 0.2
