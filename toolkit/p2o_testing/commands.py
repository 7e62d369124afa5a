"""Commands that this package adds to `p2o`; the code of each is in `p2o_testing.cli`."""

COMMANDS = {
    "doctor": "Check whether this installation works, and what is missing.",
    "plugin check": "Run the conformance checks of a plugin.",
    "plugin new": "Create a package with a small working method.",
}
"""Name and one-line help of every command."""
