"""Results of calibrations, their figures, and their JSON."""
