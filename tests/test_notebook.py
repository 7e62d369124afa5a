"""The notebook of the docs runs from top to bottom, and is kept without what a run leaves in it."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

PATH = Path(__file__).parents[1] / "docs/notebooks/first-calibration.ipynb"
NOTEBOOK: dict[str, Any] = json.loads(PATH.read_text(encoding="utf-8"))


def source(cell: dict[str, Any]) -> str:
    return "".join(cell["source"])


def test_it_is_a_notebook_without_outputs() -> None:
    assert (NOTEBOOK["nbformat"], NOTEBOOK["nbformat_minor"]) == (4, 5)
    names = [cell["id"] for cell in NOTEBOOK["cells"]]
    assert len(set(names)) == len(names)
    for cell in NOTEBOOK["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            assert cell["execution_count"] is None
        else:
            assert cell["cell_type"] == "markdown"
            for page in re.findall(r"\]\((?!https?:)([^)#]+)", source(cell)):
                assert (PATH.parent / page).is_file()


def test_its_cells_run_and_say_what_the_text_promises(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    shown: list[int] = []
    monkeypatch.setattr(plt, "show", lambda: (shown.append(len(plt.get_fignums())), plt.close("all")))
    known: dict[str, Any] = {}
    for cell in NOTEBOOK["cells"]:
        if cell["cell_type"] == "code":
            exec(compile(source(cell), cell["id"], "exec"), known)  # noqa: S102  (our own documentation)
    assert shown == [1, 1, 1]
    said = capsys.readouterr().out
    assert said.count(" -> ") == 3
    assert len(known["run"].rows) == len(known["other"].rows) == 3
    # "One result for all frames is better than any of them alone."
    single = [row.error.rotation_deg for row in known["run"].rows]
    assert known["row"].error.rotation_deg < min(single)
