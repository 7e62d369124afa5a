"""The blocks of README, CONTRIBUTING and docs: what readers copy, found for the tests that run it."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PROGRAMS = ("p2o", "python", "make", "pip", "cd", "jq", "time")
"""Words that begin a shell line of these pages."""

LANGUAGES = ("sh", "python", "toml", "yaml", "text", "mermaid")
"""What a fence may say of its block; blocks by indentation are shell lines."""


@dataclass(frozen=True)
class Block:
    """A block of a page: its language, its text, and the number of its first line."""

    page: str
    line: int
    language: str
    text: str

    def commands(self) -> Iterator[Command]:
        """Yield the commands of a shell block: lines that end in a backslash joined, `&&` apart, no comments."""
        said, first = "", 0
        for number, whole in enumerate(self.text.splitlines(), self.line):
            first = first if said else number
            # shlex takes the # of a word (@FILE#SPLIT) for a comment, too.
            line = re.sub(r"(^|\s+)#\s.*$", "", whole)
            if line.endswith("\\"):
                said += line[:-1]
                continue
            for part in re.split(r"\s&&\s", said + line):
                if part.strip():
                    yield Command(self.page, first, " ".join(part.split()))
            said = ""


@dataclass(frozen=True)
class Command:
    """One command of a page, `text` on one line."""

    page: str
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.page}:{self.line}: {self.text}"

    @property
    def words(self) -> list[str]:
        """The words without what is measured and written where (`time`, `> FILE`)."""
        words = shlex.split(self.text)
        if ">" in words:
            words = words[: words.index(">")]
        return words[1:] if words[0] == "time" else words

    @property
    def target(self) -> str | None:
        """The file that takes what it prints."""
        words = shlex.split(self.text)
        return words[words.index(">") + 1] if ">" in words else None


def pages() -> list[str]:
    """Return the pages, by their path in the repository."""
    return ["README.md", "CONTRIBUTING.md", *(str(p.relative_to(ROOT)) for p in sorted(ROOT.glob("docs/**/*.md")))]


def text_of(page: str) -> str:
    """Return the text of a page."""
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str) -> list[Block]:
    """Return all blocks of a page in their order, those in fences and those by indentation (language "")."""
    found: list[Block] = []
    fence: str | None = None
    held: list[str] = []
    # A paragraph that goes on is no block, and in a list four columns begin behind the item's.
    blank, item = True, 0
    for number, line in enumerate([*text_of(page).split("\n"), "end"], 1):
        if fence is not None:
            if line.strip() == "```":
                found.append(Block(page, number - len(held), fence, _dedented(held)))
                fence, held = None, []
            else:
                held.append(line)
            continue
        indent = len(line) - len(line.lstrip())
        if line.strip() and indent >= 4 + item and (blank or held):
            held.append(line)
            continue
        if held and line.strip():
            found.append(Block(page, number - len(held) - blank, "", _dedented(held)))
            held = []
        if line.lstrip().startswith("```"):
            fence = line.strip().removeprefix("```") or "?"
        elif line.strip() and (indent == 0 or blank):
            begins = re.match(r" *(?:[-*]|\d+\.) +", line)
            item = len(begins[0]) if begins else 0 if indent == 0 else item
        blank = not line.strip()
    assert fence is None, f"{page}: a fence is not closed"
    return found


def shell_blocks(page: str) -> list[Block]:
    """Return the blocks of shell lines."""
    return [block for block in blocks(page) if block.language in ("", "sh")]


def python_blocks(page: str) -> list[Block]:
    """Return the blocks of Python."""
    return [block for block in blocks(page) if block.language == "python"]


def inline_codes(page: str) -> Iterator[Command]:
    """Yield what stands in backticks within paragraphs."""
    text = re.sub(r"^ *```.*?^ *```$", lambda found: "\n" * found[0].count("\n"), text_of(page), flags=re.M | re.S)
    for found in re.finditer(r"`([^`]+)`", text):
        yield Command(page, text.count("\n", 0, found.start()) + 1, " ".join(found[1].split()))


def _dedented(lines: list[str]) -> str:
    least = min((len(line) - len(line.lstrip()) for line in lines if line.strip()), default=0)
    return "".join(f"{line[least:]}\n" for line in lines)
