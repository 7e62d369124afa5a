"""Old names of modules keep working, and say where they went."""

from __future__ import annotations

import importlib
import sys

import p2o
import pytest
from p2o.moved import MOVED


@pytest.mark.parametrize("old", sorted(MOVED))
def test_an_old_name_is_the_module_of_the_new_one(old: str) -> None:
    sys.modules.pop(old, None)
    with pytest.warns(DeprecationWarning, match=f"{old} has moved to {MOVED[old]}"):
        module = importlib.import_module(old)
    assert module is importlib.import_module(MOVED[old])
    assert module.__spec__.name == MOVED[old]


def test_what_plugins_took_from_modules_that_are_rooms_now_is_still_there() -> None:
    from p2o.features import CloudEdges, ImageFeatures
    from p2o.run import Row, calibrate

    assert (CloudEdges, ImageFeatures) == (p2o.CloudEdges, p2o.ImageFeatures)
    assert (Row, calibrate) == (p2o.Row, p2o.calibrate)
