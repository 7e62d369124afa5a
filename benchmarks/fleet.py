"""What does `p2o fleet` detect, and how often is it wrong?

    python benchmarks/fleet.py real --out DIR              # 200 drives of real and simulated rigs, some with a slip
    python benchmarks/fleet.py detect                      # resampled fleets: slips, drifts, wrong types, false alarms

Noise is resampled from measured evidence (`p2o_fleet/noise.json`). Each command prints tables; `kills.py` kills runs.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from fleet_detection import detect
from fleet_drives import real


def main() -> None:
    """Print the tables of a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("detect")
    drives = commands.add_parser("real")
    drives.add_argument("--root", type=Path, default=Path("build/data"), help="folder of the real frames")
    drives.add_argument("--out", type=Path, required=True, help="folder of the table, the store and the report")
    options = parser.parse_args()
    print("\n\n".join(detect() if options.command == "detect" else real(options.root, options.out)))


if __name__ == "__main__":
    main()
