"""Register the simulated data sets."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Modules are imported inside the hook, so that `p2o --help` loads none of them.


@hookimpl
def p2o_datasets() -> Iterator[Method]:
    """Yield the simulated data sets."""
    from p2o_sim import synthetic, vkitti2

    yield from (synthetic.METHOD, vkitti2.METHOD)
