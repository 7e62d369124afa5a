"""Offers the methods of this package."""

import p2o


@p2o.hookimpl
def p2o_image_extractors():
    """Offer the image side."""
    from p2o_example import grey_steps

    yield grey_steps.METHOD


@p2o.hookimpl
def p2o_solvers():
    """Offer the solver."""
    from p2o_example import gauss_newton

    yield gauss_newton.METHOD
