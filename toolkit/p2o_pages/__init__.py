"""Interactive pages: `p2o view` and `p2o pick`."""
