"""Training of methods that learn, and their label files: `p2o train` and `p2o labels`."""
