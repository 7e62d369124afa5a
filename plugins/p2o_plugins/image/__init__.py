"""Image extractors, one file a method."""
