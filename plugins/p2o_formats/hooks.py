"""Register the readers and exporters of this package."""

from __future__ import annotations

from collections.abc import Iterator

from p2o import Method, hookimpl

# Formats are imported inside the hooks, so that `p2o --help` loads none of them.


@hookimpl
def p2o_calibration_readers() -> Iterator[Method]:
    """Yield the readers of all formats."""
    from p2o_formats.formats import FORMATS

    yield from (form.reader() for form in FORMATS.values())


@hookimpl
def p2o_exporters() -> Iterator[Method]:
    """Yield the exporters of all formats that can be written, and the exporter of complete results."""
    from p2o_formats.formats import WRITTEN
    from p2o_formats.result_file import EXPORTER

    yield from (EXPORTER, *(form.exporter() for form in WRITTEN.values()))
