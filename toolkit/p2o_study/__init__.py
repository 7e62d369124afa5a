"""Lists of combinations: study files, their store, workers, the gate."""
