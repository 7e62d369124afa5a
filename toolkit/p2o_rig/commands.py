"""Commands that this package adds to `p2o`; their code is in `p2o_rig.cli`."""

COMMANDS = {"rig": "Combine results, sweeps of several LiDARs and known transforms to consistent extrinsics."}
"""Name and one-line help of every command."""
