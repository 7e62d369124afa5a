"""What tests of pages rest on: which requests of a page are seen, and which are none of the page's."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from tests.in_browser import Page, asked_for, chromium

# A port that browsers refuse to connect to: the request is made, and nothing leaves the machine.
OUTSIDE = "http://127.0.0.1:9/outside"
SOCKET = OUTSIDE.replace("http", "ws")


def sent(document: str, url: str) -> dict[str, Any]:
    return {"method": "Network.requestWillBeSent", "params": {"documentURL": document, "request": {"url": url}}}


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


def test_a_request_after_an_action_is_seen_at_once(browser: Any, tmp_path: Path) -> None:
    page = Page(browser, page_with(tmp_path, f"<button onclick=\"new Image().src = '{OUTSIDE}'\">ask</button>"))
    assert page.requests() == []
    page.click("button")
    page.until_equal(page.requests, [OUTSIDE])


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


def test_a_new_profile_asks_for_nothing_that_is_the_page_s(tmp_path: Path) -> None:
    """The first page of a new profile is the browser's own, and still loads when the first test begins."""
    with chromium(tmp_path / "profile") as driver:
        page = Page(driver, page_with(tmp_path, "<p>quiet</p>"))
        assert page.requests() == []
        assert page.complaints() == []


def test_only_what_pages_of_the_browser_itself_ask_for_is_left_out() -> None:
    page, served = "file:///tmp/page.html", "http://127.0.0.1:8080/"
    own = [
        sent("chrome://new-tab-page/", "chrome://resources/js/assert.js"),
        sent("chrome://new-tab-page/", "https://www.example.com/doodle.png"),
        sent("chrome-untrusted://new-tab-page/", "https://www.example.com/bar.js"),
        sent(page, "data:image/png;base64,AAAA"),
        sent(page, "blob:null/1"),
        {"method": "Network.loadingFinished", "params": {"requestId": "1"}},
    ]
    assert asked_for(own) == []
    counted = [
        sent(page, page),
        sent(page, "https://www.example.com/font.woff2"),
        sent(page, "chrome://resources/js/assert.js"),
        sent("about:srcdoc", "https://www.example.com/frame.png"),
        sent("https://chrome.example.com/", "https://chrome.example.com/"),
        sent(served, f"{served}part.js"),
    ]
    assert asked_for(own + counted) == [event["params"]["request"]["url"] for event in counted]
    socket = {"method": "Network.webSocketCreated", "params": {"url": "wss://www.example.com/"}}
    assert asked_for([socket]) == ["wss://www.example.com/"]
