"""Rival methods of the literature as plugins, and the study files that compare them."""
