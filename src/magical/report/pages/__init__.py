"""Pages and exported tables."""
