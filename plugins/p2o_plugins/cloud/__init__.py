"""Cloud extractors, one file a method."""
