"""The whole result as one JSON file, which reads back to an equal result."""

from __future__ import annotations

from pathlib import Path

from p2o import Exporter, Method, Options, Result
from p2o.files.whole_file import write_whole
from p2o.results.result_json import result_to_json


def build(options: Options) -> Exporter:
    """Return the exporter."""

    def export(result: Result, path: Path) -> None:
        write_whole(path, result_to_json(result).encode())

    return export


METHOD = Method(
    name="json",
    build=build,
    summary="The whole result, with rounds, recipe and versions; p2o.results.result_json reads it back.",
)
