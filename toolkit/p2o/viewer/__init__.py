"""A frame on a page in the browser, and a start found by hand (docs/how-to/view.md)."""
