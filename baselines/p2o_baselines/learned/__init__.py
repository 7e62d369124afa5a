"""Methods with trained networks."""
