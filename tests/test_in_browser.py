"""What tests of pages rest on: which requests of a page are seen, and which are none of the page's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from tests.in_browser import Page

# A port that browsers refuse to connect to: the request is made, and nothing leaves the machine.
OUTSIDE = "http://127.0.0.1:9/outside"
SOCKET = OUTSIDE.replace("http", "ws")


def page_with(folder: Path, body: str) -> Path:
    path = folder / "page.html"
    path.write_text(f'<!doctype html><link rel="icon" href="data:,"><body>{body}</body>')
    return path


@pytest.mark.parametrize(
    ("body", "url"),
    [
        (f'<img src="{OUTSIDE}">', OUTSIDE),
        (f'<link rel="stylesheet" href="{OUTSIDE}">', OUTSIDE),
        (f'<iframe src="{OUTSIDE}"></iframe>', OUTSIDE),
        (f"<iframe srcdoc=\"<img src='{OUTSIDE}'>\"></iframe>", OUTSIDE),
        (f'<script>fetch("{OUTSIDE}").catch(() => 0)</script>', OUTSIDE),
        (f'<script>navigator.sendBeacon("{OUTSIDE}")</script>', OUTSIDE),
        (f'<script>new WebSocket("{SOCKET}")</script>', SOCKET),
    ],
)
def test_a_page_that_asks_for_something_outside_is_seen(body: str, url: str, browser: Any, tmp_path: Path) -> None:
    page = Page(browser, page_with(tmp_path, body))
    found: list[str] = []

    def asked() -> list[str]:
        found.extend(page.requests())
        return found

    page.until(asked)
    assert set(found) == {url}


def test_requests_of_the_pages_before_are_not_those_of_the_page(browser: Any, tmp_path: Path) -> None:
    """A page of the browser itself has many parts, which are in the log; so may be those of another test's page."""
    (tmp_path / "before").mkdir()
    before = page_with(tmp_path / "before", f'<img src="{OUTSIDE}">')
    quiet = page_with(tmp_path, "<p>quiet</p>")
    for address in ("chrome://version", before.as_uri()):
        browser.get_log("performance")
        browser.get(address)
        assert "Network.requestWillBeSent" in json.dumps(browser.get_log("performance"))
        browser.get(address)
        assert Page(browser, quiet).requests() == []
