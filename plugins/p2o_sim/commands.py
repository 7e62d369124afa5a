"""Commands that this package adds to `p2o`; their code is in `p2o_sim.cli`."""

COMMANDS = {"simulate": "Write synthetic streets in the layout of a real dataset."}
"""Name and one-line help of every command."""
