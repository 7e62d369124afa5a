"""The page of `p2o view`: one frame in space, and an initial guess set by hand (docs/how-to/view.md)."""
