"""Wrong bytes, wrong words and wrong trees: what a damaged disk, a hurried hand and a hostile one write."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable, Sequence
from random import Random
from typing import Any

_LINES = r"""0 -0 -1 1 2 1e5 1e308 1e309 -1e309 1e-320 nan NaN inf -inf
0x10 1_000 ٣ ² true null ~ None [] {} [[[[]]]]
日本 %00 %s%n {0} {x!r} ../../escaped /etc/passwd ~nosuch/x C:\x con <script> \input{x} =1+1 2011-09-26 12:30 *a"""
_PLAIN = [line.split() for line in _LINES.splitlines()]
WORDS = (
    *("", " ", *_PLAIN[0], "9" * 19, "9" * 400, "9" * 5000, *_PLAIN[1], "a" * 70_000, "\x1b[31mred\x1b[0m", "\r"),
    *("a\x00b", "\u202egnp.exe", "\ud800", *_PLAIN[2], "&a b", "!!python/name:os.system", "<<", "1deg 1m", "1e9m"),
    *("uniform 3deg", "0-999999999999", "::0", "@x.json#y"),
)
NUMBERS = (0, -0.0, 1, -1, 2, 0.5, 255, 256, 65535, 2**31, 2**32, 2**63, -(2**63), 2**64, 10**30, 1e-320, 1e-12, 1e6)
ODD_NUMBERS = (*NUMBERS, 1e30, 1e300, float("inf"), float("-inf"), float("nan"))
VALUES: tuple[Any, ...] = (*WORDS, *ODD_NUMBERS, True, False, None, [], {}, [[]], [0] * 6, [1.0] * 16, {"a": {"b": 1}})
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")


def bytes_of(rng: Random, data: bytes, others: Sequence[bytes] = ()) -> bytes:
    """Return data after one to four random changes."""
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = rng.choice(_CHANGES)(rng, data)
    if others and rng.random() < 0.05:
        other = rng.choice(others)
        data = data[: rng.randint(0, len(data))] + other[rng.randint(0, len(other)) :]
    return data


def _span(rng: Random, data: bytes) -> tuple[int, int]:
    # Headers come first, and are where a byte matters most.
    near = rng.random() < 0.5
    start = rng.randint(0, min(len(data), 200 if near else len(data)))
    return start, min(len(data), start + int(2 ** rng.uniform(0, 12)))


def _flip(rng: Random, data: bytes) -> bytes:
    if not data:
        return data
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 4, 64))):
        start, _ = _span(rng, data)
        changed[min(start, len(data) - 1)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _overwrite(rng: Random, data: bytes) -> bytes:
    start, end = _span(rng, data)
    fill = rng.choice((b"\0", b"\xff", b" ", b"\n", None))
    new = rng.randbytes(end - start) if fill is None else fill * (end - start)
    return data[:start] + new + data[end:]


def _delete(rng: Random, data: bytes) -> bytes:
    start, end = _span(rng, data)
    return data[:start] + data[end:]


def _repeat(rng: Random, data: bytes) -> bytes:
    start, end = _span(rng, data)
    return data[:end] + data[start:end] * rng.choice((1, 2, 50)) + data[end:]


def _insert(rng: Random, data: bytes) -> bytes:
    start, _ = _span(rng, data)
    return data[:start] + rng.randbytes(rng.choice((1, 4, 100))) + data[start:]


def _cut(rng: Random, data: bytes) -> bytes:
    return data[: rng.choice((0, 1, rng.randint(0, len(data)), rng.randint(0, len(data)), max(0, len(data) - 1)))]


def _number(rng: Random, data: bytes) -> bytes:
    found = list(_NUMBER.finditer(data[:20_000]))
    if not found:
        return _word(rng, data)
    match = rng.choice(found)
    new = str(rng.choice(ODD_NUMBERS)) if rng.random() < 0.6 else rng.choice(WORDS)
    return data[: match.start()] + new.encode("utf-8", "surrogatepass") + data[match.end() :]


def _word(rng: Random, data: bytes) -> bytes:
    start, end = _span(rng, data)
    return data[:start] + rng.choice(WORDS).encode("utf-8", "surrogatepass") + data[rng.choice((start, end)) :]


def _line(rng: Random, data: bytes) -> bytes:
    lines = data.split(b"\n", 400)
    at, other = rng.randrange(len(lines)), rng.randrange(len(lines))
    how = rng.randrange(4)
    if how == 0:
        del lines[at]
    elif how == 1:
        lines.insert(at, lines[other])
    elif how == 2:
        lines[at], lines[other] = lines[other], lines[at]
    else:
        lines[at] = rng.choice((b"", b" ", b"\t", b"#", lines[at][::-1], lines[at] * 2))
    return b"\n".join(lines)


def _ends(rng: Random, data: bytes) -> bytes:
    return rng.choice(
        (b"\xef\xbb\xbf" + data, data.replace(b"\n", b"\r\n"), data + data, data + b"\0" * 4096, data[::-1])
    )


_CHANGES: tuple[Callable[[Random, bytes], bytes], ...] = (
    *(_flip, _flip, _overwrite, _delete, _repeat, _insert, _cut, _number, _number, _word, _line, _line, _ends),
)


def tree_of(rng: Random, tree: Any) -> Any:
    """Return a tree of mappings, lists and values after one to three random changes."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 2, 3))):
        places = list(_places(tree))
        if not places:
            return rng.choice(VALUES)
        _change(rng, *rng.choice(places))
    return tree


def _places(tree: Any) -> Any:
    if isinstance(tree, dict):
        for key, value in tree.items():
            yield tree, key
            yield from _places(value)
    elif isinstance(tree, list):
        for key, value in enumerate(tree):
            yield tree, key
            yield from _places(value)


def _change(rng: Random, inner: Any, key: Any) -> None:
    value = inner[key]
    how = rng.randrange(9)
    if how == 0 and isinstance(inner, dict):
        inner[rng.choice((f"{key}s", str(key).upper(), rng.choice(WORDS)))] = inner.pop(key)
    elif how == 1:
        del inner[key]
    elif how == 2:
        inner[key] = [value] * rng.choice((1, 2, 1000))
    elif how == 3 and isinstance(value, list) and value:
        inner[key] = rng.choice((value[:-1], [*value, value[-1]], value[::-1], value[0]))
    elif how in (4, 5) and isinstance(value, int | float) and not isinstance(value, bool):
        inner[key] = rng.choice(
            (-value, value * 1e-3, value * 1e3, value + 1, value * 1.0001, str(value), value * 1e12)
        )
    elif how == 6:
        deep: Any = value
        for _ in range(rng.choice((1, 3, 100))):
            deep = rng.choice(([deep], {"a": deep}))
        inner[key] = deep
    elif how == 7 and isinstance(inner, dict):
        inner[rng.choice(WORDS)] = rng.choice(VALUES)
    else:
        inner[key] = rng.choice(VALUES)
