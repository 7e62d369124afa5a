"""One method of a plan with its validated options."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from p2o.errors import InputError, P2OError, one_line
from p2o.files.parsed_text import parse_json
from p2o.host.registry import Offer, fault, watch
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
        try:
            options = validated(offer.method.options, values, stage)
        except InputError as problem:
            raise _of_default(offer, stage, values, problem) from problem
        _refuse_unstorable(offer, options)
    return Part(offer, options)


def _of_default(offer: Offer, stage: str, values: Mapping[str, Any], problem: InputError) -> P2OError:
    """Return the error of options; that of a default, which the user has not set, names the plugin."""
    fields = offer.method.options.model_fields
    name = problem.what.removeprefix(f"{stage}.").partition(" ")[0].partition(".")[0]
    given = name in values or name not in fields or fields[name].is_required()
    return problem if given else fault(offer, f"the default of {problem}")


def _refuse_unstorable(offer: Offer, options: Options) -> None:
    """Raise PluginError for options that results and stored rows cannot contain."""
    try:
        parse_json(options.model_dump_json(), "text of the options")
    except (InputError, ValueError) as problem:
        what = f"its options cannot be stored in results: {one_line(problem)}"
        raise fault(offer, what, "finite numbers, texts, lists and dicts") from problem
