"""Files: written whole or not at all, and names that any system takes."""
