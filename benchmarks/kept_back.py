"""Print the table of results on frames that were kept back from development, as measured by others.

    python benchmarks/kept_back.py FILE.md [--weights free] [--columns "deg median;cm median;good"]

FILE has a Markdown table with the columns set, weights and mode, as `kept-back-0.2.0.md`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from limits_and_tables import table


def kept_back(text: str, weights: str | None, columns: list[str] | None) -> str:
    """Return the rows of the table in `text` with these weights, and these of its columns, as a Markdown table."""
    lines = [line.strip().strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    head, _, *rows = ([cell.strip() for cell in line] for line in lines)
    chosen = [name for name in head if columns is None or name in ("set", "weights", "mode", *columns)]
    if weights is not None:
        rows = [row for row in rows if row[head.index("weights")] == weights]
        chosen.remove("weights")
    return table(chosen, [[row[head.index(name)] for name in chosen] for row in rows])


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("file", type=Path)
    parser.add_argument("--weights")
    parser.add_argument("--columns", type=lambda text: text.split(";"))
    given = parser.parse_args()
    print(kept_back(given.file.read_text(encoding="utf-8"), given.weights, given.columns))


if __name__ == "__main__":
    main()
