"""Pickles of one small table, written by pandas itself: x, y, z, i, t as numbers, d as whole numbers; three points."""

from __future__ import annotations

import lzma
from pathlib import Path

_LABELS = (
    "1.0.5, protocol 2",
    "1.0.5, protocol 4",
    "1.2.5, protocol 5",
    "1.5.3, the points with d = 0",
    "2.2.3, protocol 5",
    "3.1.1, protocol 5",
)
_PACKED = Path(__file__).with_name("pandas_pickles.xz").read_bytes()
PICKLES = dict(zip(_LABELS, lzma.decompress(_PACKED).split(b"--next--"), strict=True))
X = [1.5, 2.5, -3.0]
T = [1557539924.5, 1557539924.6, 1557539924.7]
D = [0, 1, 0]
