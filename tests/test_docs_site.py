"""The site of docs/ is built without a broken link, and what it says of the code is what the code says."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from html import unescape
from pathlib import Path
from typing import Any

import p2o
import pytest
from p2o.cli import _COMMANDS
from p2o.host.registry import Registry

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site, built in strict mode: a link to nowhere is an error."""
    if importlib.util.find_spec("material") is None:
        pytest.skip('the site needs mkdocs-material: pip install "p2o-calib[docs]"')
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "--site-dir", str(folder)]
    environ = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=ROOT, env=environ)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def text_of(page: Path) -> str:
    """Return the words of a page without its tags."""
    return unescape(re.sub(r"<[^>]+>", "", page.read_text(encoding="utf-8")))


def test_every_page_of_docs_is_on_the_site_and_in_its_navigation(site: Path) -> None:
    listed = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for page in (ROOT / "docs").rglob("*.md"):
        name = page.relative_to(ROOT / "docs")
        assert (site / name.with_suffix("") / "index.html").is_file()
        assert f": {name.as_posix()}\n" in listed, f"{name} is not in the navigation of mkdocs.yml"


def test_figures_from_rows_do_not_end_paragraphs_and_lists() -> None:
    # A line that begins with a comment is a block of HTML, also within a paragraph.
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]:
        broken = re.findall(r"^[ \t]*<!-- value.*", page.read_text(encoding="utf-8"), re.MULTILINE)
        assert not broken, f"{page.relative_to(ROOT)}: move a word to the front of these lines: {broken}"


def test_records_that_pages_name_exist() -> None:
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]:
        for name in re.findall(r"benchmarks/results/records/[\w-]+\.json", page.read_text(encoding="utf-8")):
            assert (ROOT / name).is_file(), f"{page.relative_to(ROOT)} names {name}"


def test_the_front_page_is_the_readme(site: Path) -> None:
    page = (site / "index.html").read_text(encoding="utf-8")
    assert "estimates the rigid transform between a camera and a LiDAR" in page
    assert 'src="gallery/crossing.webp"' in page
    assert (site / "gallery/crossing.webp").is_file()
    assert 'href="docs/' not in page
    assert 'href="model-card/"' in page


def test_no_page_fetches_anything_from_elsewhere(site: Path) -> None:
    for page in site.rglob("*.html"):
        said = page.read_text(encoding="utf-8")
        fetched = re.findall(r'<(?:script|img|link)[^>]*(?:src|href)="(https?:[^"]+)"', said)
        assert not fetched, f"{page}: {fetched}"


def test_the_reference_names_every_command_with_its_options(site: Path) -> None:
    text = text_of(site / "reference/commands/index.html")
    for name in _COMMANDS:
        assert f"p2o {name}" in text
    for said in ("p2o plugin new", "--slot", "p2o data topics", "--joint", "--protocol"):
        assert said in text


def test_the_reference_names_every_method_with_its_options(site: Path) -> None:
    page = (site / "reference/methods/index.html").read_text(encoding="utf-8")
    for offer in Registry.load(plugins=["p2o-calib"]).offers:
        assert f'id="{offer.kind.value.replace(" ", "-")}-{offer.name}"' in page
        for option in offer.method.options.model_fields:
            assert f"<code>{option}</code>" in page


def test_the_reference_names_every_public_name(site: Path) -> None:
    page = (site / "reference/python/index.html").read_text(encoding="utf-8")
    for name in (*p2o.__all__, *p2o.solving.__all__, *p2o.reading.__all__):
        assert f'id="{name.lower()}"' in page


WIDER_THAN_A_PHONE = """
const wide = (e) => e.getBoundingClientRect().right > innerWidth + 1;
const scrolls = (e) => ['auto', 'scroll'].includes(getComputedStyle(e).overflowX);
const held = (e) => e !== null && ((scrolls(e) && !wide(e)) || held(e.parentElement));
const blocks = [...document.querySelectorAll('article pre, article table')].filter((e) => wide(e) && !held(e));
return [document.documentElement.scrollWidth > innerWidth ? 'the page' : '', ...blocks.map((e) => e.textContent)];
"""


def test_every_code_block_and_table_is_readable_on_a_phone(site: Path, browser: Any) -> None:
    from tests.in_browser import window

    offenders = {}
    with window(browser, 390, 844):
        for path in sorted(site.rglob("index.html")):
            browser.get(path.as_uri())
            wider = browser.execute_script(WIDER_THAN_A_PHONE)
            offenders[path.parent.name] = [text[:60] for text in wider if text]
    assert len(offenders) > 40
    assert not {name: texts for name, texts in offenders.items() if texts}
