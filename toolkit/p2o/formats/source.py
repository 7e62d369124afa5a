"""A calibration file as it was read once: its bytes, and what they are as text, JSON or YAML."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from p2o.errors import InputError
from p2o.files.input_file import read_bytes
from p2o.files.parsed_text import parse_json, parse_yaml

_WHAT = "calibration file"
_MOST_BYTES = 16 << 20
"""Results with many rounds are the largest that are read; all others are a few pages."""
_OPENCV_HEAD = re.compile(r"\A\ufeff?%YAML:1\.0[^\n]*\n")


@dataclass(frozen=True)
class Source:
    """The bytes of a file; each form of them is parsed once, and None where they do not have it."""

    path: Path
    data: bytes

    @classmethod
    def of(cls, path: Path) -> Source:
        """Return the file; raises InputError as `read_bytes`, and for files that are too large for a calibration."""
        return cls(path, read_bytes(path, _WHAT, _MOST_BYTES))

    @cached_property
    def text(self) -> str:
        """The text, empty for bytes that are none."""
        try:
            return self.data.decode("utf-8").removeprefix("\ufeff").replace("\r\n", "\n")
        except UnicodeDecodeError:
            return ""

    @cached_property
    def lines(self) -> list[str]:
        """The lines that are neither blank nor begin with #."""
        return [line for line in self.text.splitlines() if line.strip() and not line.lstrip().startswith("#")]

    @cached_property
    def is_opencv(self) -> bool:
        """Whether it is YAML as cv::FileStorage writes it."""
        return bool(_OPENCV_HEAD.match(self.text)) or "!!opencv-matrix" in self.text[:100_000]

    @cached_property
    def _parsed(self) -> tuple[Any, InputError | None]:
        """The value of JSON or YAML, and why there is none."""
        text = self.text.strip()
        try:
            if text.startswith(("{", "[")) and self.path.suffix.lower() not in (".yaml", ".yml"):
                return parse_json(text, _WHAT, self.path), None
            if not text or text.startswith("<"):
                return None, None
            if self.is_opencv:
                # Its directive is no YAML, and its tags name a type that says no more than the keys below them.
                text = _OPENCV_HEAD.sub("", text).replace("!!opencv-matrix", "").removeprefix("---")
            # `ros2 topic echo` ends a message so.
            return parse_yaml(text.removesuffix("---"), _WHAT, self.path), None
        except InputError as problem:
            return None, problem

    @property
    def value(self) -> Any:
        """What the file holds as JSON or YAML, or None."""
        return self._parsed[0]

    @property
    def problem(self) -> InputError | None:
        """Why it is neither JSON nor YAML, where it looked like it."""
        return self._parsed[1]

    @property
    def tree(self) -> dict[str, Any]:
        """The keys of JSON or YAML, empty where it is something else."""
        value = self.value
        return value if isinstance(value, dict) else {}
