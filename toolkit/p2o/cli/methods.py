"""`p2o methods`: list and explain the installed methods, and show which are compatible."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from textwrap import wrap
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

import click

from p2o.cli.completion import complete_methods
from p2o.cli.plugin_options import load, plugin_options

if TYPE_CHECKING:
    from p2o.host.registry import Offer, Registry
    from p2o.options import Options
    from p2o.run.overview import MethodFacts

_PIPELINE = "pipeline"


@click.command("methods")
@click.argument("name", required=False, shell_complete=complete_methods(published=True))
@click.option(
    "--matrix",
    is_flag=True,
    help="Show what published methods need, are for and reach, and which extractors, matchers and solvers fit.",
)
@plugin_options
def command(name: str | None, matrix: bool, plugin: tuple[str, ...], block: tuple[str, ...]) -> int:
    """List the installed methods, or explain one with all its options.

    The first list contains the methods of `p2o run --method` with the options that they stand for. NAME may be
    name@distribution if two plugins offer it. `pipeline` explains the options of the rounds of extraction, matching and
    solving.
    """
    from p2o.run.overview import method_facts
    from p2o.run.presets import presets

    registry = load(plugin, block)
    if name is not None:
        published = presets(registry)
        ours = [pipeline_explained()] if name == _PIPELINE else []
        ours += (
            [f"method {published[name].label or name}\n  --method {name} stands for {published[name]}"]
            if name in published
            else []
        )
        named = [o for o in registry.offers if o.name == name] if ours else registry.named(name)
        facts = [_facts_text(one) for one in method_facts(registry) if one.name == name]
        click.echo("\n\n".join([*ours, *map(explained, named), *facts]))
    elif matrix:
        click.echo("\n\n".join(filter(None, (facts_table(registry), fit_matrix(registry)))))
    else:
        click.echo(listed(registry))
    return 0


def listed(registry: Registry) -> str:
    """Return all methods by kind, one per line, with the distribution if it is not p2o; first the published ones."""
    from p2o.run.presets import presets

    blocks = []
    published = presets(registry)
    width = max((len(name) for name in [*map(_shown, registry.offers), *published]), default=0)
    if published:
        rows = [f"  {name:<{width}}  {preset}" for name, preset in published.items()]
        blocks.append("\n".join(["methods (p2o run --method NAME; calibrators, too)", *rows]))
    for kind in dict.fromkeys(offer.kind for offer in registry.offers):
        rows = [f"  {_shown(offer):<{width}}  {offer.method.summary}" for offer in registry.of_kind(kind)]
        blocks.append("\n".join([f"{kind.value}s", *rows]))
    if blocks:
        text = "Rounds, judge, camera and motion of the calibration algorithm."
        blocks.append(f"{_PIPELINE}\n  {_PIPELINE:<{width}}  {text}")
    blocks += [f"broken plugin {b.name}: {b.error}" for b in registry.broken]
    return "\n".join(blocks) if blocks else "no methods: all plugins are left out"


def pipeline_explained() -> str:
    """Return the options of the pipeline in the form of a method."""
    from p2o.calibration.options import PipelineOptions

    lines = [_PIPELINE, f"  summary  {PipelineOptions.__doc__}", f"  options  (--set {_PIPELINE}.NAME=VALUE)"]
    return "\n".join([*lines, *_option_table(PipelineOptions)])


def explained(offer: Offer) -> str:
    """Return the declaration of a method as text."""
    from p2o.host.registry import requirement
    from p2o.host.slots import SLOT_OF

    method = offer.method
    facts = {
        "summary": method.summary,
        "plugin": f"{offer.dist} {offer.version}".strip(),
        "needs": ", ".join(sorted(method.needs)),
        "gives": ", ".join(sorted(method.gives)),
        "install": f"pip install {requirement(offer)}" if method.extra else "",
        "cite": method.cite,
        "known to fail": "; ".join(f"{check}: {reason}" for check, reason in method.expected_failures),
    }
    lines = [f"{offer.kind} {method.name}"]
    lines += [f"  {label:<8} {text}" for label, text in facts.items() if text]
    table = _option_table(method.options)
    setting = SLOT_OF[offer.kind].setting(method.name, "NAME", "VALUE")
    lines += [f"  options  ({setting})", *table] if table else ["  options  none"]
    if method.trainer is not None:
        presets = ", ".join(method.trainer.presets)
        words = f"--set NAME=VALUE{f'; presets: {presets}' if presets else ''}"
        lines.append(f"  training (p2o train {method.name} {words})")
        lines += _option_table(method.trainer.options)
    return "\n".join(lines)


def _option_table(options: type[Options]) -> list[str]:
    """Return the options of a model: name, default and type, and the description indented below them."""
    rows = [option_row(name, field) for name, field in options.model_fields.items()]
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(2)]
    indent = " " * 8
    lines = []
    for name, default, kind, description in rows:
        lines += wrap(
            f"    {name:<{widths[0]}}  {default:<{min(widths[1], 16)}}  {kind}", 110, subsequent_indent=indent
        )
        lines += wrap(description, 110, initial_indent=indent, subsequent_indent=indent)
    return lines


def option_row(name: str, field: Any) -> tuple[str, str, str, str]:
    """Return name, default, type with bounds, and description of an option."""
    default = "(required)" if field.is_required() else str(field.get_default(call_default_factory=True))
    kind = " ".join([_type_text(field.annotation), _bounds_text(field.metadata)]).strip()
    return name, default, kind, field.description or ""


def _type_text(annotation: Any) -> str:
    """Return a type for users: `float >= 0`, `none | all`, `6 x float`; bounds within it are in its metadata."""
    parts = get_args(annotation)
    origin = get_origin(annotation)
    if origin is Annotated:
        rules = [rule for part in parts[1:] for rule in getattr(part, "metadata", [part])]
        return f"{_type_text(parts[0])} {_bounds_text(rules)}".strip()
    if origin is Literal:
        return " | ".join(map(str, parts))
    if origin in (Union, UnionType):
        return " | ".join("null" if part is type(None) else _type_text(part) for part in parts)
    if origin is tuple and Ellipsis not in parts:
        texts = [f"{len(list(same))} x {text}" for text, same in groupby(map(_type_text, parts))]
        return ", ".join(text.removeprefix("1 x ") for text in texts)
    if parts:
        return f"list of {_type_text(parts[0])}"
    return str(getattr(annotation, "__name__", annotation))


_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def _bounds_text(rules: Iterable[Any]) -> str:
    """Return the bounds of a number as text, such as `>= 0, < 90`."""
    limits = ((sign, getattr(rule, word, None)) for rule in rules for word, sign in _SIGNS.items())
    return ", ".join(f"{sign} {value:g}" for sign, value in limits if value is not None)


def facts_table(registry: Registry) -> str:
    """Return what published methods need and are for, and their errors, measured here and published."""
    from p2o.run.overview import method_facts

    return "\n".join(_facts_text(one) for one in method_facts(registry))


def _facts_text(one: MethodFacts) -> str:
    facts = {"needs": one.needs_text, "for": one.use, "measured": one.measured, "published": one.published}
    return "\n".join([f"{one.name} ({one.paper})", *(f"  {name:<9} {text}" for name, text in facts.items())])


def fit_matrix(registry: Registry) -> str:
    """Return two tables of compatibility: extractors with matchers, and matchers with solvers."""
    from p2o.host.method import Kind
    from p2o.run.fit import missing_words

    def table(title: str, heads: list[str], rows: list[tuple[str, list[bool]]]) -> str:
        first = max([len(name) for name, _ in rows] + [len(title)])
        lines = [f"{title:<{first}}  " + "  ".join(heads)]
        for name, cells in rows:
            marks = [f"{'yes' if fits else '-':^{len(head)}}" for fits, head in zip(cells, heads, strict=True)]
            lines.append((f"{name:<{first}}  " + "  ".join(marks)).rstrip())
        return "\n".join(lines)

    def names(offers: tuple[Offer, ...]) -> list[str]:
        clashing = {o.name for o in offers if sum(p.name == o.name for p in offers) > 1}
        return [o.full_name if o.name in clashing else o.name for o in offers]

    matchers, solvers = registry.of_kind(Kind.MATCHER), registry.of_kind(Kind.SOLVER)
    images, clouds = registry.of_kind(Kind.IMAGE_EXTRACTOR), registry.of_kind(Kind.CLOUD_EXTRACTOR)
    pairs = [
        (f"{i}/{c}", [not missing_words(m.method.needs, [image, cloud]) for m in matchers])
        for image, i in zip(images, names(images), strict=True)
        for cloud, c in zip(clouds, names(clouds), strict=True)
    ]
    solved = [
        (name, [not missing_words(s.method.needs, [matcher]) for s in solvers])
        for matcher, name in zip(matchers, names(matchers), strict=True)
    ]
    tables = table("extractor \\ matcher", names(matchers), pairs), table("matcher \\ solver", names(solvers), solved)
    return "\n\n".join(tables)


def _shown(offer: Offer) -> str:
    return offer.name if offer.dist == "p2o-calib" else offer.full_name
