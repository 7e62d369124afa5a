"""Commands of the interactive pages."""
