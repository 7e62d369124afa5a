"""Pages in a real browser, headless: what a reader does on them, what they ask for and what they complain of."""

from __future__ import annotations

import contextlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("selenium", reason="selenium is not installed")

from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.by import By

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


class Page:
    """A page in a browser, with what a reader does on it."""

    def __init__(self, driver: Any, path: Path) -> None:
        self.driver, self.url = driver, path.as_uri()
        driver.get_log("browser")
        driver.get_log("performance")
        driver.get(self.url)

    def find(self, css: str) -> Any:
        return self.driver.find_element(By.CSS_SELECTOR, css)

    def texts(self, css: str) -> list[str]:
        return [e.get_property("textContent") for e in self.driver.find_elements(By.CSS_SELECTOR, css)]

    def column(self, table: str, title: str) -> list[str]:
        """Return the texts of one column of a table, from top to bottom."""
        place = self.texts(f"#{table} thead th").index(title) + 1
        return self.texts(f"#{table} tbody td:nth-child({place})")

    def sort(self, table: str, title: str) -> None:
        place = self.texts(f"#{table} thead th").index(title) + 1
        self.click(f"#{table} thead th:nth-child({place}) button")

    def click(self, css: str) -> None:
        element = self.find(css)
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
        element.click()

    def run(self, script: str) -> Any:
        return self.driver.execute_script(script)

    def complaints(self) -> list[str]:
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def requests(self) -> list[str]:
        """Return the addresses that were asked for, besides the page itself and what stands in it."""
        events = [json.loads(entry["message"])["message"] for entry in self.driver.get_log("performance")]
        sent = [e["params"]["request"]["url"] for e in events if e["method"] == "Network.requestWillBeSent"]
        sockets = [e["params"]["url"] for e in events if e["method"] == "Network.webSocketCreated"]
        return [url for url in sent + sockets if url != self.url and not url.startswith(("data:", "blob:"))]


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
