"""Features that extractors return, and views of frames with their features."""
