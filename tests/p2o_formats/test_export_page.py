"""The page about calibration files names every form with what it holds."""

from __future__ import annotations

import re
from pathlib import Path

from p2o_formats.formats import FORMATS

PAGE = (Path(__file__).parents[2] / "docs/how-to/export.md").read_text(encoding="utf-8")


def test_the_table_lists_every_form_with_what_it_holds() -> None:
    rows = re.findall(r"^\| `([\w-]+)` \| (camera|extrinsic|camera, extrinsic|all of a result) \|", PAGE, re.MULTILINE)
    expected = {name: ", ".join(sorted(form.holds)) for name, form in FORMATS.items()} | {"json": "all of a result"}
    assert dict(rows) == expected
