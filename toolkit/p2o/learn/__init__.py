"""Training of methods that learn, and their label files."""
