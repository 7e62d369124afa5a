"""Methods that maximise the mutual information of both sensors."""
