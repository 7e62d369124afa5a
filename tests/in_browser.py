"""Pages in a real browser, headless: what a reader does on them, what they ask for and what they complain of."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from selenium import webdriver
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    NoSuchElementException,
    StaleElementReferenceException,
    TimeoutException,
)
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By
from selenium.webdriver.support.ui import Select, WebDriverWait

SWITCHES = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1400,1000",
)

WAIT_S = 60

T = TypeVar("T")

# Pages of the browser itself. No page of a file or of a server can be one of these, or hold one in a frame.
INTERNAL = ("chrome:", "chrome-untrusted:", "chrome-search:", "devtools:")

AGAIN = (NoSuchElementException, StaleElementReferenceException, ElementClickInterceptedException)

COLUMN = """
return [...document.querySelectorAll(`#${arguments[0]} tbody td:nth-child(${arguments[1]})`)].map((e) => e.textContent)
"""


class Page:
    """A page in a browser, with what a reader does on it.

    A browser answers before a busy machine has drawn what was asked for, so whatever is read after an action is read
    until it is as expected: see `until` and `until_equal`.
    """

    def __init__(self, driver: Any, address: Path | str) -> None:
        self.driver, self.url = driver, address if isinstance(address, str) else address.as_uri()
        # A new profile begins with the new-tab page, whose requests go on while the next page is asked for. Once the
        # empty page is there, the requests of every page before it are in the logs, which are emptied by reading.
        driver.get("about:blank")
        self.until(lambda: self.run("return location.href === 'about:blank' && document.readyState === 'complete'"))
        driver.get_log("browser")
        driver.get_log("performance")
        driver.get(self.url)
        self.until(lambda: self.run("return location.href !== 'about:blank' && document.readyState === 'complete'"))

    # ---- waiting

    def until(self, read: Callable[[], T], message: str = "") -> T:
        """Wait until a reading is true, and return it; elements that were replaced meanwhile are read again."""
        return WebDriverWait(self.driver, WAIT_S, ignored_exceptions=AGAIN).until(lambda _: read(), message)

    def until_equal(self, read: Callable[[], Any], expected: Any) -> None:
        """Wait until a reading equals what is expected, or fail with both."""
        found: list[Any] = []

        def equal() -> bool:
            found[:] = [read()]
            return bool(found[0] == expected)

        with contextlib.suppress(TimeoutException):
            self.until(equal)
        assert found == [expected], f"{found} is not {[expected]}"

    # ---- reading

    def find(self, css: str) -> Any:
        return self.driver.find_element(By.CSS_SELECTOR, css)

    def count(self, css: str) -> int:
        return int(self.run("return document.querySelectorAll(arguments[0]).length", css))

    def text(self, css: str) -> str:
        """Return the text of an element as it is seen."""
        return str(self.find(css).text)

    def texts(self, css: str) -> list[str]:
        """Return the texts of elements, all of the same moment."""
        return list(self.run("return [...document.querySelectorAll(arguments[0])].map((e) => e.textContent)", css))

    def column(self, table: str, title: str) -> list[str]:
        """Return the texts of one column of a table, from top to bottom, all of the same moment."""
        return list(self.run(COLUMN, table, self._place(table, title)))

    def _place(self, table: str, title: str) -> int:
        """Return the place of a column of a table, from 1, once there is one of this title."""
        head = f"#{table} thead th"
        self.until(lambda: title in self.texts(head), f"no column {title!r} in {head}")
        return self.texts(head).index(title) + 1

    def run(self, script: str, *arguments: Any) -> Any:
        return self.driver.execute_script(script, *arguments)

    def complaints(self, *levels: str) -> list[str]:
        """Return what the browser complained of, at any level or at these."""
        said = self.driver.get_log("browser")
        return [entry["message"] for entry in said if not levels or entry["level"] in levels]

    def requests(self) -> list[str]:
        """Return the addresses that were asked for, besides the page itself and what stands in it."""
        events = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        return [url for url in asked_for(events) if url != self.url]

    def elsewhere(self) -> list[str]:
        """Return the addresses that were asked for outside of the server of the page."""
        own = (self.url, self.url.replace("http", "ws", 1))
        return [url for url in self.requests() if not url.startswith(own)]

    # ---- what a reader does

    def click(self, css: str) -> None:
        """Click an element, again if it was replaced or covered before the click."""

        def clicked() -> bool:
            element = self.find(css)
            self.run("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", element)
            element.click()
            return True

        self.until(clicked)

    def sort(self, table: str, title: str) -> None:
        """Click the title of a column, and wait until the table is sorted by it the other way round."""
        cell = f"#{table} thead th:nth-child({self._place(table, title)})"
        way = "return document.querySelector(arguments[0]).getAttribute('aria-sort')"
        wanted = "descending" if self.run(way, cell) == "ascending" else "ascending"
        self.click(f"{cell} button")
        self.until_equal(lambda: self.run(way, cell), wanted)

    def choose(self, css: str, text: str) -> None:
        """Choose what a list offers under this text, once it does."""
        self.until(lambda: text in self.texts(f"{css} option"), f"no {text!r} in {css}")
        Select(self.find(css)).select_by_visible_text(text)

    def write(self, css: str, *keys: str, value: str) -> None:
        """Press keys in a field, and wait until it holds this text."""
        field = self.find(css)
        field.send_keys(*keys)
        self.until_equal(lambda: field.get_property("value"), value)


def asked_for(events: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the addresses that pages asked for, in the events of a performance log.

    What stands in a page itself is none, nor is what the pages of the browser itself ask for. Everything else is one,
    whichever document, frame or script it comes from.
    """
    found = []
    for event in events:
        told = event["params"]
        if event["method"] == "Network.webSocketCreated":
            found.append(told["url"])
        elif event["method"] == "Network.requestWillBeSent" and not told["documentURL"].startswith(INTERNAL):
            found.append(told["request"]["url"])
    return [url for url in found if not url.startswith(("data:", "blob:"))]


@contextlib.contextmanager
def window(driver: Any, width: int, height: int) -> Iterator[None]:
    """Give the pages of a browser a window of this size; a narrow one is that of a phone."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@contextlib.contextmanager
def chromium(profile: Path) -> Iterator[Any]:
    """Yield a headless Chromium with a profile of its own, or skip and say how to get one."""
    binary, driver_binary = shutil.which("chromium"), shutil.which("chromedriver")
    if binary is None or driver_binary is None:
        pytest.skip("no Chromium: apt-get install chromium chromium-driver")
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for switch in (*SWITCHES, f"--user-data-dir={profile}"):
        options.add_argument(switch)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(driver_binary))
    try:
        yield driver
    finally:
        driver.quit()
