"""Register the simulated data sets."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl, methods_at


@hookimpl
def p2o_datasets() -> Iterator[Method]:
    """Offer the simulated data sets."""
    return methods_at("p2o_sim", ("synthetic", "vkitti2"))
