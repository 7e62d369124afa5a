"""Methods that align objects, lanes and segments."""
