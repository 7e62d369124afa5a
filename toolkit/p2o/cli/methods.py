"""`p2o methods`: what is installed, what one method does, and which methods fit together."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from p2o.cli.plugin_options import load, plugin_options

if TYPE_CHECKING:
    from p2o.host.registry import Offer, Registry
    from p2o.options import Options

_PIPELINE = "pipeline"


@click.command("methods")
@click.argument("name", required=False)
@click.option("--matrix", is_flag=True, help="Show which extractors, matchers and solvers fit together.")
@plugin_options
def command(name: str | None, matrix: bool, plugin: tuple[str, ...], block: tuple[str, ...]) -> int:
    """List the methods that are installed, or explain one with all its options.

    NAME may be written name@distribution where two plugins offer it. `pipeline` explains the options of the rounds that
    extractors, matcher, solver and init are run in.
    """
    registry = load(plugin, block)
    if name is not None:
        ours = [pipeline_explained()] if name == _PIPELINE else []
        named = [o for o in registry.offers if o.name == _PIPELINE] if ours else registry.named(name)
        click.echo("\n\n".join([*ours, *map(explained, named)]))
    elif matrix:
        click.echo(fit_matrix(registry))
    else:
        click.echo(listed(registry))
    return 0


def listed(registry: Registry) -> str:
    """Return all methods by kind, one a line; the distribution is named where it is not ours."""
    blocks = []
    width = max((len(_shown(offer)) for offer in registry.offers), default=0)
    for kind in dict.fromkeys(offer.kind for offer in registry.offers):
        rows = [f"  {_shown(offer):<{width}}  {offer.method.summary}" for offer in registry.of_kind(kind)]
        blocks.append("\n".join([f"{kind.value}s", *rows]))
    if blocks:
        blocks.append(f"{_PIPELINE}\n  {_PIPELINE:<{width}}  Rounds, judge, camera and motion: what runs the stages.")
    blocks += [f"broken plugin {b.name}: {b.error}" for b in registry.broken]
    return "\n".join(blocks) if blocks else "no methods: every plugin is left out"


def pipeline_explained() -> str:
    """Return the options of the pipeline, as those of a method."""
    from p2o.calibration.options import PipelineOptions

    lines = [_PIPELINE, f"  summary  {PipelineOptions.__doc__}", f"  options  (--set {_PIPELINE}.NAME=VALUE)"]
    return "\n".join([*lines, *_option_table(PipelineOptions)])


def explained(offer: Offer) -> str:
    """Return everything that a method says about itself."""
    from p2o.host.guard import requirement
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
        lines.append(
            f"  training (p2o train {method.name} --set NAME=VALUE{f'; presets: {presets}' if presets else ''})"
        )
        lines += _option_table(method.trainer.options)
    return "\n".join(lines)


def _option_table(options: type[Options]) -> list[str]:
    """Return the options of a model, one a line."""
    rows = [option_row(name, field) for name, field in options.model_fields.items()]
    widths = [max(len(row[i]) for row in rows) for i in range(3)] if rows else []
    return [
        "    " + "  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=False)) + f"  {row[3]}" for row in rows
    ]


def option_row(name: str, field: Any) -> tuple[str, str, str, str]:
    """Return name, default, type with bounds, and description of an option."""
    default = "(required)" if field.is_required() else str(field.get_default(call_default_factory=True))
    annotation = field.annotation
    kind = annotation.__name__ if isinstance(annotation, type) else str(annotation).replace("typing.", "")
    signs = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
    bounds = [
        f"{sign} {getattr(rule, word):g}"
        for rule in field.metadata
        for word, sign in signs.items()
        if getattr(rule, word, None) is not None
    ]
    return name, default, " ".join([kind, ", ".join(bounds)]).strip(), field.description or ""


def fit_matrix(registry: Registry) -> str:
    """Return two tables: which matcher takes which pair of extractors, and which solver takes which matcher."""
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
    return (
        table("extractor \\ matcher", names(matchers), pairs)
        + "\n\n"
        + table("matcher \\ solver", names(solvers), solved)
    )


def _shown(offer: Offer) -> str:
    return offer.name if offer.dist == "p2o-calib" else offer.full_name
