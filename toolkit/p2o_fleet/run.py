"""Check the drives of a fleet on workers, and store the evidence of each as soon as it is finished."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

from p2o_study.parallel import Workers
from p2o_study.worker import Plugins

from p2o_fleet.drive import Drive
from p2o_fleet.evidence import Evidence
from p2o_fleet.store import Store
from p2o_fleet.worker import CheckSettings, DriveJob, check_drive, unreadable

OnCheck = Callable[["RunOutcome", Evidence], None]


@dataclass
class RunOutcome:
    """Counts of a run: checks by verdict, `kept` ones that were stored before, and whether it was interrupted.

    `damaged` are files and lines of the store that were skipped.
    """

    verdicts: Counter[str] = field(default_factory=Counter)
    kept: int = 0
    damaged: Sequence[str] = ()
    seconds: float = 0.0
    interrupted: bool = False

    @property
    def checked(self) -> int:
        """Return the number of checks of this run."""
        return self.verdicts.total()


def run_fleet(
    drives: Iterable[Drive],
    store: Store,
    *,
    settings: CheckSettings,
    plugins: Plugins,
    workers: Workers,
    on_check: OnCheck = lambda outcome, evidence: None,
) -> RunOutcome:
    """Check all drives that are not stored yet; the same drives again change nothing.

    A drive that is named twice is checked once. Evidence is on the disk before the next result is taken. Drives whose
    worker dies become rows with the reason.
    """
    outcome, taken = RunOutcome(), set[str]()

    def jobs() -> Iterator[DriveJob]:
        for drive in drives:
            key = drive.key(settings.text)
            if key in taken or writer.finished(drive, key):
                outcome.kept += 1
            else:
                taken.add(key)
                yield DriveJob(drive, key, settings, plugins)

    with store.writer() as writer, workers.start() as run:
        try:
            with contextlib.closing(run(check_drive, jobs(), unreadable)) as results:
                for evidence in results:
                    writer.put(evidence)
                    outcome.verdicts[evidence.verdict.value] += 1
                    outcome.seconds += evidence.seconds
                    on_check(outcome, evidence)
        except KeyboardInterrupt:
            outcome.interrupted = True
        outcome.damaged = tuple(dict.fromkeys(writer.damaged))
    return outcome
