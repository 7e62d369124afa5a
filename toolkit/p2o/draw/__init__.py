"""Pictures of one result: overlays and plots."""
