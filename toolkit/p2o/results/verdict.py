"""The verdict on a result: trusted, ambiguous, doubtful or refused, and the reasons."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Trust(StrEnum):
    """The word of a verdict, best first."""

    TRUSTED = "trusted"
    AMBIGUOUS = "ambiguous"
    DOUBTFUL = "doubtful"
    REFUSED = "refused"


class Doubt(StrEnum):
    """A reason to doubt a result."""

    NOT_SOLVED = "not-solved"
    LITTLE_AGREEMENT = "little-agreement"
    NOT_CHECKED = "not-checked"
    RIVAL_POSE = "rival-pose"
    TOO_FEW_PLACES = "too-few-places"
    TOO_UNSURE = "too-unsure"
    LED_AWAY = "led-away"
    CAMERA = "camera"
    OUTSIDE_BOX = "outside-box"
    CONTRADICTION = "contradiction"
    TOO_FEW_CAMERAS = "too-few-cameras"

    @property
    def trust(self) -> Trust:
        """The best verdict that a result with this doubt can have."""
        others = {Doubt.NOT_SOLVED: Trust.REFUSED, Doubt.RIVAL_POSE: Trust.AMBIGUOUS}
        return others.get(self, Trust.DOUBTFUL)


@dataclass(frozen=True)
class Reason:
    """A doubt about a result, with an explanation of one sentence."""

    doubt: Doubt
    text: str


_ORDER = tuple(Trust)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a result and its `reasons`; a trusted result has none.

    `refused`: there is no new pose. `doubtful`: image and sweep do not agree at this pose, no independent check was
    possible, the predicted error is large, the pose is outside the box of the search, or the intrinsics of the camera
    are in doubt. `ambiguous`: another pose fits
    about as well. `trusted`: none of these.
    """

    reasons: tuple[Reason, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "reasons", tuple(dict.fromkeys(self.reasons)))  # each once

    @property
    def trust(self) -> Trust:
        """The verdict in one word."""
        return max((reason.doubt.trust for reason in self.reasons), key=_ORDER.index, default=Trust.TRUSTED)

    @property
    def trusted(self) -> bool:
        """True where no reason lowers the verdict."""
        return self.trust is Trust.TRUSTED

    @property
    def why(self) -> str:
        """The reasons in one text, empty where there are none."""
        return "; ".join(reason.text for reason in self.reasons)

    def having(self, *reasons: Reason) -> Verdict:
        """Return the verdict with further reasons."""
        return Verdict((*self.reasons, *reasons))
