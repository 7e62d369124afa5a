"""The word `accumulate` of a recipe: what joined sweeps lose and need, and accumulators that are broken."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import p2o
import pytest
from p2o import Cloud, Frame, InputError, Kind, Method, PluginError, Recipe, Registry
from p2o_testing import stage

from tests.toolkit.offered import registry_with


class Frames(list[Frame]):
    """A dataset that is a list."""

    @property
    def names(self) -> list[str]:
        return [frame.name for frame in self]


class Joins:
    """Joins the points of all frames it is shown."""

    past, future = 2, 1

    def __call__(self, frames: list[Frame], number: int) -> Cloud:
        assert all(frame.camera_from_lidar is None for frame in frames)
        return Cloud(np.concatenate([frame.cloud.xyz for frame in frames]))


def drive(sequences: str = "aaab") -> Frames:
    cloud = stage.frame().cloud.select(np.arange(100))
    return Frames(
        replace(stage.frame(), name=f"{i}", cloud=cloud, sequence=s, time_s=0.1 * i) for i, s in enumerate(sequences)
    )


def registry(make: object) -> Registry:
    def beams(options):
        return lambda cloud: p2o.CloudFeatures(p2o.CloudEdges.empty())

    joins = Method(name="joins", build=lambda options: make, summary="Joins.", needs={"sequence"}, gives={"dense"})
    gives = {"cloud-edges", "side"}
    needy = Method(name="beams", build=beams, summary="Needs rings.", needs={"rings"}, gives=gives)
    return registry_with((Kind.ACCUMULATOR, joins), (Kind.CLOUD_EXTRACTOR, needy))


def test_what_needs_rings_is_refused_where_sweeps_are_joined() -> None:
    """Before data are read where the dataset says what it gives; else with the first frame."""
    words = {"extractor": "depth/beams", "accumulate": "joins"}
    with pytest.raises(InputError, match="kitti-odometry gives no rings; beams needs it"):
        Recipe.of(**words, data="kitti-odometry:/nowhere").resolve(registry(Joins()))
    plan = Recipe.of(**words, data=None).resolve(registry(Joins()))
    frame = plan.joined(drive())[1]
    assert len(frame.cloud) == 300
    with pytest.raises(InputError, match="the frame has no rings; beams needs it"):
        plan.check_frame(frame)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (3, "build returned int; expected something to call"),
        (type("NoPast", (), {"__call__": lambda self, f, n: f[n].cloud, "future": 1})(), "with `past` and `future`"),
        (type("Minus", (Joins,), {"past": -1})(), "`past` is -1; expected a number of frames"),
        (type("Bad", (Joins,), {"__call__": lambda self, f, n: None})(), "returned NoneType; expected p2o.Cloud"),
        (type("Raises", (Joins,), {"__call__": lambda self, f, n: 1 / 0})(), "raised ZeroDivisionError while joining"),
    ],
)
def test_a_broken_accumulator_names_its_plugin(make: object, text: str) -> None:
    with pytest.raises(PluginError, match=f"accumulator 'joins'.*{text}"):
        Recipe.of(data=None, accumulate="joins").resolve(registry(make)).joined(drive())[0]
