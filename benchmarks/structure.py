"""Measure the repository: lines per package, words of docs, rooms and imports of the toolkit, longest functions.

    python benchmarks/structure.py [PATH]     this tree or another checkout

Lines are those of Python files, words those of Markdown pages in docs/, rows the files of benchmarks/results. Rooms are
the folders and modules directly in toolkit/p2o, without the public modules `p2o`, `p2o.solving` and `p2o.reading`. An
arrow is a pair of rooms of which the first imports the second, anywhere in its files; a package is in a circle if it
imports itself through others.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

import p2o

PACKAGES, PUBLIC = ("toolkit", "plugins", "baselines"), {"__init__", "__main__", "solving", "reading"}


def lines(paths: Iterable[Path]) -> int:
    """Return the number of lines of files, as `wc -l`."""
    return sum(path.read_bytes().count(b"\n") for path in paths)


def imported(path: Path) -> Iterator[list[str]]:
    """Yield the parts of the dotted names that a file imports: `from p2o import se3` names p2o.se3."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".") for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            parts = node.module.split(".")
            yield from ([*parts, alias.name] if len(parts) == 1 else parts for alias in node.names)


def arrows(core: Path) -> tuple[set[str], set[tuple[str, str]]]:
    """Return the rooms of the toolkit and the pairs (room, imported room)."""
    files = {path: path.relative_to(core).parts[0].removesuffix(".py") for path in core.rglob("*.py")}
    rooms = set(files.values()) - PUBLIC
    pairs = {
        (room, parts[1])
        for path, room in files.items()
        if room in rooms
        for parts in imported(path)
        if parts[0] == "p2o" and len(parts) > 1 and parts[1] in rooms - {room}
    }
    return rooms, pairs


def circle(roots: Iterable[Path]) -> list[str]:
    """Return the packages that import themselves through others."""
    imports: dict[str, set[str]] = defaultdict(set)
    packages = {folder.name: folder for root in roots for folder in root.iterdir() if (folder / "__init__.py").exists()}
    for name, folder in packages.items():
        imports[name] = {parts[0] for path in folder.rglob("*.py") for parts in imported(path)} & packages.keys()
        imports[name].discard(name)
    for _ in packages:
        for name in packages:
            imports[name] |= {far for near in set(imports[name]) for far in imports[near]}
    return sorted(name for name in packages if name in imports[name])


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
    command[0] = str(Path(sys.executable).with_name(command[0]))
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    matches = (re.search(r"`(.+)` is too complex \((\d+)", row["message"]) for row in json.loads(done.stdout))
    return max((int(match[2]), match[1]) for match in matches if match)


def options() -> tuple[int, int, int]:
    """Return the options of the installed methods, those declared once (not inherited), and the number of methods."""
    classes = [offer.method.options for offer in p2o.Registry.load(environ={}).offers]
    declared = {(base, name) for kind in classes for base in kind.__mro__ for name in inspect.get_annotations(base)}
    return sum(len(kind.model_fields) for kind in classes), len(declared), len(classes)


def main() -> None:
    """Print the measurements."""
    root = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1]).resolve()
    paths = sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))
    counts = Counter[str]()
    for path in paths:
        counts["/".join(path.relative_to(root).parts[:2])] += lines([path])
    rows = sum(path.stat().st_size for path in (root / "benchmarks/results").glob("*.jsonl"))
    tokens = [token for page in (root / "docs").rglob("*.md") for token in page.read_text(encoding="utf-8").split()]
    words = sum(any(map(str.isalnum, token)) for token in tokens)
    rooms, pairs = arrows(root / "toolkit" / "p2o")
    for name, count, unit in [
        *((package, count, "lines") for package, count in sorted(counts.items())),
        ("product", counts.total(), "lines"),
        ("tests", lines((root / "tests").rglob("*.py")), "lines"),
        ("benchmarks/*.py", lines((root / "benchmarks").glob("*.py")), "lines"),
        ("docs", words, f"words, {len(tokens)} with the marks of tables and commands"),
        ("benchmarks/results", round(rows / 1e6), "MB of rows"),
        ("toolkit/p2o", len(rooms), f"rooms, {len(pairs)} arrows"),
    ]:
        print(f"{name:28} {count:7} {unit}")
    print("options: {} ({} declarations) of {} methods".format(*options()))
    print(f"packages in a circle of imports: {', '.join(circle(root / package for package in PACKAGES)) or 'none'}")
    print("longest function: {} lines ({})".format(*longest_function(paths)))
    print("highest complexity: {} ({})".format(*most_complex(root)))


if __name__ == "__main__":
    main()
