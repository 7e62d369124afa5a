"""Overlays of the worst and the median run of a row, drawn from the synthetic data of its suite."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from p2o.draw.image_uri import jpeg_uri
from p2o.errors import P2OError
from p2o.host.registry import Registry
from p2o.run.words import split_data

from p2o_study.benchmark.suite import SuiteFile
from p2o_study.report.overlays import drawn_run
from p2o_study.row import Row

SYNTHETIC = "synthetic"
"""The dataset whose images may be published without a licence."""
MAX_RUNS = 400


@dataclass
class Overlays:
    """Draws overlays and counts them: `drawn`, and `left_out`, whose methods or frames are not those of the rows."""

    registry: Registry
    drawn: int = 0
    left_out: int = 0

    def of(self, suite: SuiteFile, rows: Sequence[Row]) -> list[dict[str, str]]:
        """Return the overlays of rows in descending order of their errors: those of the first and the median one.

        They have name, frame, and images before and after as data URIs. None is drawn for other data than synthetic
        ones, external methods, crashed rows, and more than `MAX_RUNS` runs.
        """
        tables = {table.name: table for table in suite.study.study.dataset}
        table = tables.get(rows[0].dataset)
        if table is None or split_data(table.data)[0] != SYNTHETIC:
            return []
        shown = []
        for place, name in {len(rows) // 2: "median error", 0: "largest error"}.items():
            if self.drawn + self.left_out >= MAX_RUNS:
                break
            row = rows[place]
            named = replace(row, case=replace(row.case, data=SYNTHETIC, options=table.options))
            try:
                if row.method.external or row.crashed:
                    raise P2OError("no features of the row can be drawn")
                frame, before, after = drawn_run(named, table.data, self.registry)
            except P2OError:
                self.left_out += 1
                continue
            self.drawn += 1
            frame_text = f"{frame.name}, seed {row.seed}"
            shown.append({"name": name, "frame": frame_text, "before": jpeg_uri(before), "after": jpeg_uri(after)})
        return shown[::-1]
