"""Offers every method of this package; each lives in the file of its name, which is imported when it is used."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl, methods_at


def _methods(folder: str, *files: str) -> Iterator[Method]:
    return methods_at("p2o_plugins", [f"{folder}.{file}" for file in files])


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    return _methods("image", "depth", "p2ornet", "stereo")


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    return _methods("cloud", "range_view", "rings")


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    return _methods("match", "ogm")


@hookimpl
def p2o_solvers() -> Iterator[Method]:
    """Offer the solvers."""
    scalar = ("barzilai_borwein", "bfgs", "cma_es", "coordinate", "grid729", "nelder_mead", "particle_swarm")
    return _methods("solve", "ceres", "lm", "scipy_least_squares", *scalar, "pnp", "random_shrink")


@hookimpl
def p2o_initializers() -> Iterator[Method]:
    """Offer the initializers."""
    return _methods("initialize", "far", "given", "grid", "search")


@hookimpl
def p2o_accumulators() -> Iterator[Method]:
    """Offer the accumulators."""
    return _methods("accumulate", "joining:GICP", "joining:KISS_ICP", "joining:POSES")
