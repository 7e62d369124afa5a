"""Measure the structure of the code: lines per package, rooms of the toolkit, imports between them, longest functions.

    python benchmarks/structure.py            this tree
    python benchmarks/structure.py PATH       another checkout

Rooms are the folders and modules directly in toolkit/p2o, without the public modules `p2o`, `p2o.solving` and
`p2o.reading`. An arrow is a pair of rooms of which the first imports the second, anywhere in its files.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

PACKAGES = ("toolkit", "plugins", "baselines")
PUBLIC = {"__init__", "__main__", "solving", "reading"}


def sources(root: Path) -> list[Path]:
    """Return the Python files of the product."""
    return sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))


def arrows(core: Path) -> tuple[set[str], set[tuple[str, str]]]:
    """Return the rooms of the toolkit and the pairs (room, imported room)."""
    rooms: set[str] = set()
    pairs: set[tuple[str, str]] = set()
    for path in core.rglob("*.py"):
        room = path.relative_to(core).parts[0].removesuffix(".py")
        if room in PUBLIC:
            continue
        rooms.add(room)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.module:
                names = [f"p2o.{a.name}" for a in node.names] if node.module == "p2o" else [node.module]
            for name in names:
                parts = name.split(".")
                if parts[0] == "p2o" and len(parts) > 1 and parts[1] != room:
                    pairs.add((room, parts[1]))
    return rooms, {pair for pair in pairs if pair[1] in rooms}


def longest_function(paths: list[Path]) -> tuple[int, str]:
    """Return lines and name of the longest function, decorators not counted."""
    return max(
        (node.end_lineno - node.lineno + 1, f"{path.stem}.{node.name}")
        for path in paths
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.end_lineno is not None
    )


def most_complex(root: Path) -> tuple[int, str]:
    """Return the highest cyclomatic complexity (McCabe, as ruff computes it) and the name of the function."""
    command = ["ruff", "check", "--isolated", "--select", "C901", "--config", "lint.mccabe.max-complexity=10"]
    command += ["--output-format", "json", "--exit-zero", *PACKAGES]
    ruff = Path(sys.executable).with_name(command[0])
    done = subprocess.run([str(ruff), *command[1:]], cwd=root, capture_output=True, text=True, check=True)
    found = (re.search(r"`(.+)` is too complex \((\d+)", row["message"]) for row in json.loads(done.stdout))
    return max((int(match[2]), match[1]) for match in found if match)


def main() -> None:
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1]).resolve()
    paths = sources(root)
    lines = Counter[str]()
    for path in paths:
        lines["/".join(path.relative_to(root).parts[:2])] += len(path.read_text(encoding="utf-8").splitlines())
    for package, count in sorted(lines.items()):
        print(f"{package:28} {count:7} lines")
    print(f"{'in total':28} {lines.total():7} lines")
    rooms, pairs = arrows(root / "toolkit" / "p2o")
    print(f"{'toolkit/p2o':28} {len(rooms):7} rooms, {len(pairs)} arrows")
    print("longest function: {} lines ({})".format(*longest_function(paths)))
    print("highest complexity: {} ({})".format(*most_complex(root)))


if __name__ == "__main__":
    main()
