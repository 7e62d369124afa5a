"""Checks of matchers: derivatives are compared row by row, and a tenth of the rows may differ."""

from __future__ import annotations

from typing import Any

import numpy as np
import p2o
import pytest
from p2o import Kind, Method
from p2o_testing import CheckFailed, checks_for
from p2o_testing.checks import matchers

from tests.broken_methods import REGISTRY, kinds


def derivatives_checked(share: float, factor: float = 2.0) -> None:
    """Check the derivatives of a matcher of which every row of a share is `factor` times too large."""

    class Scaled(kinds.PointsToSpots):  # type: ignore[name-defined,misc]
        def residuals_with_jacobian(self, camera_from_lidar: Any) -> Any:
            residuals, jacobian = super().residuals_with_jacobian(camera_from_lidar)
            scaled = np.arange(len(jacobian)) < share * len(jacobian)
            return residuals, np.where(scaled[:, None], factor * jacobian, jacobian)

    def match(views: Any, pose: Any, reach_px: float) -> p2o.solving.Problem:
        good = kinds.spots_matched(views, pose, reach_px)
        return Scaled(good.xyz, good.uv, good.weight, good.frame, good.camera)

    needs = {"image-edges", "cloud-edges"}
    method = Method(name="scaled", build=lambda _: match, summary="A test.", gives={"residuals"}, needs=needs)
    for case in checks_for(method, Kind.MATCHER, registry=REGISTRY):
        if case.check.function is matchers.jacobians_agree_with_differences:
            case()
            return
    pytest.fail("this check is not among those of a matcher")


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_derivatives_may_differ_in_a_few_rows(share: float) -> None:
    derivatives_checked(share)


@pytest.mark.parametrize(("share", "factor"), [(0.3, 2.0), (1.0, 1.01), (1.0, -1.0), (1.0, 0.0)])
def test_derivatives_of_another_size_or_sign_are_found(share: float, factor: float) -> None:
    with pytest.raises(CheckFailed, match=f"{100 * share:.0f} % of the derivatives are not those of their residuals"):
        derivatives_checked(share, factor)
