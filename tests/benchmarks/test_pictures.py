"""The figures of the pages are small and shown somewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.pages import ROOT, pages, text_of

GALLERY = ROOT / "docs/gallery"
PICTURES = sorted(path for path in GALLERY.iterdir() if path.suffix in (".jpg", ".png", ".webp"))
MOST_BYTES = {".jpg": 200_000, ".png": 200_000, ".webp": 500_000}


@pytest.mark.parametrize("picture", PICTURES, ids=lambda path: path.name)
def test_a_picture_is_small_and_some_page_shows_it(picture: Path) -> None:
    assert picture.stat().st_size <= MOST_BYTES[picture.suffix]
    assert any(f"gallery/{picture.name}" in text_of(page) for page in pages())


def test_a_picture_of_real_sensors_has_its_notice() -> None:
    real = [path.name for path in PICTURES if path.suffix == ".webp" and not path.name.startswith("record-")]
    assert real == ["crossing.webp", "published-acfr.webp", "published-pjlab-1.webp", "published-pjlab-2.webp"]
    notice = (GALLERY / "NOTICE").read_text(encoding="utf-8")
    assert all(name in notice for name in real)
    assert notice.startswith("crossing.webp")
    assert "Apache License, Version 2.0" in notice
    assert "Apache License" in (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert re.search(r"crossing\.webp\).*\[notice\]\(docs/gallery/NOTICE\)", text_of("README.md"), re.DOTALL)
