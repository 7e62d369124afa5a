"""What a cloud extractor has to say about a sweep, beside what it found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from p2o.arrays import Float
from p2o.features.feature import CloudFeature


@dataclass(frozen=True, eq=False)
class CloudRemarks(CloudFeature):
    """Remarks in one line each, which become warnings of the result, named by their frame."""

    word: ClassVar[str] = "cloud-remarks"

    texts: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.texts)

    def moved(self, b_from_lidar: Float) -> CloudRemarks:
        """Return the remarks as they are."""
        return self
