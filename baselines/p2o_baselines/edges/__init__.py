"""Methods that align edges of image and sweep."""
