"""Points that a person picked in image and sweep: their file, and the page on which `p2o pick` has them clicked."""
