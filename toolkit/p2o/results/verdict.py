"""Whether a result may be trusted, and why not: the answer to "is my result good?" in one word and its reasons."""

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
    """What speaks against a result."""

    NOT_SOLVED = "not-solved"
    LITTLE_AGREEMENT = "little-agreement"
    NOT_CHECKED = "not-checked"
    RIVAL_POSE = "rival-pose"
    TOO_FEW_PLACES = "too-few-places"
    TOO_UNSURE = "too-unsure"
    LED_AWAY = "led-away"
    CAMERA = "camera"
    CONTRADICTION = "contradiction"
    TOO_FEW_CAMERAS = "too-few-cameras"

    @property
    def trust(self) -> Trust | None:
        """The best verdict that a result with this doubt can have; None where it is a remark only."""
        return {
            Doubt.NOT_SOLVED: Trust.REFUSED,
            Doubt.LITTLE_AGREEMENT: Trust.DOUBTFUL,
            Doubt.NOT_CHECKED: Trust.DOUBTFUL,
            Doubt.TOO_FEW_PLACES: Trust.DOUBTFUL,
            Doubt.TOO_UNSURE: Trust.DOUBTFUL,
            Doubt.LED_AWAY: Trust.DOUBTFUL,
            Doubt.CONTRADICTION: Trust.DOUBTFUL,
            Doubt.TOO_FEW_CAMERAS: Trust.DOUBTFUL,
            Doubt.RIVAL_POSE: Trust.AMBIGUOUS,
        }.get(self)


@dataclass(frozen=True)
class Reason:
    """One thing that speaks against a result, and what it means in a sentence."""

    doubt: Doubt
    text: str


_ORDER = tuple(Trust)


@dataclass(frozen=True)
class Verdict:
    """Whether a result may be trusted; `reasons` say why not, and are remarks where it may be.

    `refused`: there is no new pose. `doubtful`: image and sweep do not seem to belong together at this pose, too little
    could check that they do, or it may be far off by its own likely error. `ambiguous`: another pose fits about as
    well. `trusted`: none of these.
    """

    reasons: tuple[Reason, ...] = ()

    @property
    def trust(self) -> Trust:
        """The word."""
        words = [reason.doubt.trust for reason in self.reasons]
        return max((word for word in words if word is not None), key=_ORDER.index, default=Trust.TRUSTED)

    @property
    def trusted(self) -> bool:
        """True where nothing speaks against the result."""
        return self.trust is Trust.TRUSTED

    @property
    def why(self) -> str:
        """The reasons in one text, empty where there are none."""
        return "; ".join(reason.text for reason in self.reasons)

    def having(self, *reasons: Reason) -> Verdict:
        """Return the verdict with further reasons."""
        return Verdict((*self.reasons, *reasons))
