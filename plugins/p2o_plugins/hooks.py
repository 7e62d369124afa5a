"""Offers every method of this package; each lives in the file of its name."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Files are imported inside of the hooks, so that nothing is read for `p2o --help`.


@hookimpl
def p2o_image_extractors() -> Iterator[Method]:
    """Offer the image sides."""
    from p2o_plugins.image import depth, p2ornet, stereo

    yield from (depth.METHOD, p2ornet.METHOD, stereo.METHOD)


@hookimpl
def p2o_cloud_extractors() -> Iterator[Method]:
    """Offer the LiDAR sides."""
    from p2o_plugins.cloud import range_view, rings

    yield from (range_view.METHOD, rings.METHOD)


@hookimpl
def p2o_matchers() -> Iterator[Method]:
    """Offer the matchers."""
    from p2o_plugins.match import ogm

    yield ogm.METHOD


@hookimpl
def p2o_solvers() -> Iterator[Method]:
    """Offer the solvers."""
    from p2o_plugins.solve import (
        barzilai_borwein,
        bfgs,
        ceres,
        cma_es,
        coordinate,
        grid729,
        lm,
        nelder_mead,
        particle_swarm,
        pnp,
        random_shrink,
        scipy_least_squares,
    )

    yield from (ceres.METHOD, lm.METHOD, scipy_least_squares.METHOD)
    yield from (barzilai_borwein.METHOD, bfgs.METHOD, cma_es.METHOD, coordinate.METHOD, grid729.METHOD)
    yield from (nelder_mead.METHOD, particle_swarm.METHOD, pnp.METHOD, random_shrink.METHOD)


@hookimpl
def p2o_initializers() -> Iterator[Method]:
    """Offer the ways to find a start."""
    from p2o_plugins.initialize import far, given, grid, search

    yield from (far.METHOD, given.METHOD, grid.METHOD, search.METHOD)


@hookimpl
def p2o_accumulators() -> Iterator[Method]:
    """Offer the ways to join sweeps."""
    from p2o_plugins.accumulate import gicp, kiss_icp, poses

    yield from (gicp.METHOD, kiss_icp.METHOD, poses.METHOD)


@hookimpl
def p2o_datasets() -> Iterator[Method]:
    """Offer the datasets."""
    from p2o_plugins.data import (
        argoverse2,
        folder,
        kitti_360,
        kitti_object,
        kitti_odometry,
        kitti_raw,
        nuscenes,
        once,
        pandaset,
        ros,
        synthetic,
        vkitti2,
        waymo,
    )

    kitti = (kitti_360.METHOD, kitti_object.METHOD, kitti_odometry.METHOD, kitti_raw.METHOD, vkitti2.METHOD)
    others = (argoverse2.METHOD, nuscenes.METHOD, once.METHOD, pandaset.METHOD, waymo.METHOD)
    yield from (folder.METHOD, *kitti, *others, ros.METHOD, synthetic.METHOD)


@hookimpl
def p2o_exporters() -> Iterator[Method]:
    """Offer the formats of results."""
    from p2o_plugins.export import calibration_file, json_file

    yield from (json_file.METHOD, *calibration_file.METHODS)
