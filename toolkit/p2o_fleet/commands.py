"""Commands that the fleet package adds to `p2o`; the code of each is in `p2o_fleet.cli`."""

COMMANDS = {"fleet": "Check the extrinsics of many vehicles, find slips and systematic errors, write a page."}
"""Name and one-line help of every command."""
