"""Commands that the interactive pages package adds to `p2o`; the code of each is in `p2o_pages.cli`."""

COMMANDS = {
    "view": "Show a frame in 3-D, and set an initial guess by hand, on a page in the browser.",
    "pick": "Pick points in image and sweep by hand, on a page in the browser.",
}
"""Name and one-line help of every command."""
