"""Methods that use the motion of both sensors."""
