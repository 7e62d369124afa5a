"""The calibration files of other systems as exporters: every form of `p2o.formats` that is written, by its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from p2o import Exporter, InputError, Method, Options, Result
from p2o.files.whole_file import write_whole
from p2o.formats.calibration import Calibration
from p2o.formats.files import formats
from p2o.formats.format import Format

_CITE = {"kitti": "Geiger et al., IJRR 2013", "koide": "Koide et al., ICRA 2023", "opencalib": "Yan et al., 2022"}


def method_of(form: Format) -> Method:
    """Return the exporter of a form of file."""
    return Method(
        name=form.name,
        build=_builder(form),
        options=form.options,
        summary=form.summary,
        cite=_CITE.get(form.name, ""),
    )


def _builder(form: Format) -> Callable[[Options], Exporter]:
    def build(options: Options) -> Exporter:
        """Return the exporter; it raises InputError for a result without a pose, and for cameras without a name."""

        def export(result: Result, path: Path) -> None:
            if not result.status.solved:
                raise InputError(
                    "this result has no new pose to export",
                    where=path,
                    expected="a solved calibration",
                    got=f"{result.status.value} ({result.reason})",
                    hint="export it with json, which keeps the status",
                )
            write_whole(path, form.written(Calibration(result.intrinsics, result.camera_from_lidar), options, path))

        return export

    return build


METHODS = tuple(method_of(form) for form in formats().values() if form.write is not None)
