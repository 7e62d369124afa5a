"""Overlays of the worst and the median run of a row, drawn from the synthetic data of its suite."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from p2o.draw.image_uri import jpeg_uri
from p2o.errors import P2OError
from p2o.frames.frame import Frame
from p2o.host.registry import Registry
from p2o.run.words import split_data

from p2o_study.benchmark.outcomes import Outcomes, Runs
from p2o_study.benchmark.row import FrameData, Row
from p2o_study.benchmark.suite import SuiteFile
from p2o_study.report.overlays import drawn_run
from p2o_study.store import StoredRow
from p2o_study.study import DatasetTable
from p2o_study.worker import content_digests

SYNTHETIC = "synthetic"
"""The dataset whose images may be published without a licence."""
MAX_RUNS = 400


@dataclass
class Overlays:
    """Draws overlays and counts them: `drawn`, and `left_out`, whose methods or frames are not those of the rows."""

    registry: Registry
    drawn: int = 0
    left_out: int = 0

    def of(self, suite: SuiteFile, outcomes: Outcomes, runs: Runs) -> list[dict[str, str]]:
        """Return the overlays of runs in descending order of their errors: those of the first and the median one.

        None is drawn for other data than synthetic ones, external methods, and more than `MAX_RUNS` runs.
        """
        tables = {table.name: table for table in suite.study.study.dataset}
        table = tables.get(outcomes.datasets[int(runs["dataset"][0])])
        if table is None or split_data(table.data)[0] != SYNTHETIC:
            return []
        shown = []
        for place, name in {len(runs) // 2: "median error", 0: "largest error"}.items():
            if self.drawn + self.left_out < MAX_RUNS:
                number = int(np.flatnonzero(outcomes.runs["offset"] == runs["offset"][place])[0])
                overlay = self._drawn(outcomes.row(number), table)
                shown += [{"name": name, **overlay}] if overlay else []
        return shown[::-1]

    def _drawn(self, row: Row, table: DatasetTable) -> dict[str, str]:
        """Return frame and images as data URIs at the initial guess and at the result; empty if they are left out."""
        try:
            if row.method.external or row.crashed:
                raise P2OError("no features of the row can be drawn")
            frame, before, after = drawn_run(_stored(row, table), table.data, self.registry)
            if _digest(row, frame) != row.frames[0].digest:
                raise P2OError("the frame differs from that of the row")
        except P2OError:
            self.left_out += 1
            return {}
        self.drawn += 1
        return {"frame": f"{frame.name}, seed {row.seed}", "before": jpeg_uri(before), "after": jpeg_uri(after)}


def _stored(row: Row, table: DatasetTable) -> StoredRow:
    """Return the row as the report draws it: first frame, poses and recipe."""
    recipe = {**row.method.words, "options": {**row.method.options, "data": table.options}, "seed": row.seed}
    estimate = row.start if row.estimate is None else row.estimate
    return StoredRow(
        row.digest,
        row.suite,
        row.row,
        dataset=row.dataset,
        frames=(row.frames[0].name,),
        seed=row.seed,
        estimate=estimate,
        start=row.start,
        recipe=recipe,
    )


def _digest(row: Row, frame: Frame) -> str:
    truth = None if frame.camera_from_lidar is None else frame.camera_from_lidar.tolist()
    values = {"dataset": row.dataset, "name": frame.name, "truth": truth, **content_digests(frame)}
    return FrameData.model_validate(values).digest
