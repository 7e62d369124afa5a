"""One method of a plan with its validated options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from p2o.errors import InputError
from p2o.host.registry import Offer, watch
from p2o.options import Options, validated


@dataclass(frozen=True)
class Part:
    """One method of a plan with its validated options."""

    offer: Offer
    options: Options

    def build(self) -> Any:
        """Return the guarded stage; heavy packages are imported here."""
        from p2o.host.guard import build

        return build(self.offer, self.options)


def part_of(offer: Offer, stage: str, values: dict[str, Any], seed: int) -> Part:
    """Return the method with its options validated; a field called `seed` follows the recipe's unless it is set."""
    fields = offer.method.options.model_fields
    if stage == "data" and "root" in values and "root" not in fields:
        root = values["root"]
        hint = f"options follow a question mark: {offer.name}:?{root}" if "=" in str(root) else None
        raise InputError(f"dataset {offer.name} takes no path", expected=f"{offer.name}:", got=root, hint=hint)
    if stage == "data" and "root" in fields and fields["root"].is_required() and "root" not in values:
        raise InputError(f"dataset {offer.name} needs a path", expected=f"{offer.name}:PATH")
    if "seed" in fields:
        values = {"seed": seed, **values}
    with watch(offer, "validating its options"):
        options = validated(offer.method.options, values, stage)
        options.model_dump_json()  # results and stored rows contain them
    return Part(offer, options)
