"""Commands of the study package."""
