"""Commands that this package adds to `p2o`; their code is in `p2o_datasets.cli`."""

COMMANDS = {"data topics": "List the topics of a ROS bag."}
"""Name and one-line help of every command."""
