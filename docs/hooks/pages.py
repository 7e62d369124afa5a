"""Pages of the site that are not files of docs/: the front page and others from the root, and what the code tells."""

from __future__ import annotations

import inspect
import json
import posixpath
import re
from collections.abc import Iterator
from enum import Enum
from pathlib import Path
from typing import Any

import click
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[2]
FROM_ROOT = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "plugins/p2o_plugins/weights/MODEL_CARD.md": "model-card.md",
    "THIRD_PARTY.md": "third-party.md",
    "CITATION.cff": "CITATION.cff",
}
"""Files of the repository that are shown on the site, by their path on it."""

NOTEBOOKS = {"notebooks/first-calibration.ipynb": "tutorial/notebook.md"}
"""Notebooks of docs/ that are pages, too, without what running them shows."""

_LINK = re.compile(r"\[([^\[\]]*)\]\((?!https?:|mailto:|#)([^)\s#]+)(#[^)\s]*)?\)")
_ITEM = re.compile(r"([-*]|\d+\.) ")


def on_files(files: Files, config: Any) -> Files:
    """Add the files of the root and the pages that are made of the code."""
    for source, target in FROM_ROOT.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        made = _linked(text, source, target) if source.endswith(".md") else text
        files.append(File.generated(config, target, content=made))
    for source, target in NOTEBOOKS.items():
        files.append(File.generated(config, target, content=_linked(notebook(source), f"docs/{source}", target)))
    for target, page in (("commands", commands), ("methods", methods), ("python", python)):
        files.append(File.generated(config, f"reference/{target}.md", content=page()))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Let links out of docs/ point to where the site has those files, and lists begin where GitHub begins them."""
    if page.file.generated_by is None:
        markdown = _linked(markdown, f"docs/{page.file.src_uri}", page.file.src_uri)
    return _spaced(markdown)


def _linked(text: str, source: str, target: str) -> str:
    """Return a text whose links, relative to `source` in the repository, are relative to `target` on the site."""

    def link(match: re.Match[str]) -> str:
        meant = posixpath.normpath(posixpath.join(posixpath.dirname(source), match[2]))
        shown = FROM_ROOT.get(meant) or (meant.removeprefix("docs/") if meant.startswith("docs/") else None)
        if shown is None:
            # A file of the sources is named, but is no page; of others strict mode says that they are missing.
            return match[1] if (ROOT / meant).is_file() else match[0]
        return f"[{match[1]}]({posixpath.relpath(shown, posixpath.dirname(target) or '.')}{match[3] or ''})"

    return _LINK.sub(link, text)


def _spaced(text: str) -> str:
    """Return a text with a blank line before each list: Python-Markdown takes it for a part of the paragraph else."""
    lines: list[str] = []
    fenced = False
    for line in text.split("\n"):
        if line.lstrip().startswith("```"):
            fenced = not fenced
        last = lines[-1] if lines else ""
        begins = _ITEM.match(line) and last and not last[0].isspace() and not _ITEM.match(last)
        # A line that goes on with an item is indented; a paragraph is not.
        if begins and not fenced:
            lines.append("")
        lines.append(line)
    return "\n".join(lines)


def notebook(source: str) -> str:
    """Return the page of a notebook: its texts, and its code in blocks."""
    content = json.loads((ROOT / "docs" / source).read_text(encoding="utf-8"))
    parts = []
    for cell in content["cells"]:
        text = "".join(cell["source"])
        parts.append(f"```python\n{text}\n```" if cell["cell_type"] == "code" else text)
    title, _, rest = "\n\n".join(parts).partition("\n")
    name = posixpath.basename(source)
    return f"{title}\n\nThis page is the notebook [{name}]({name}), to be downloaded and run.\n{rest}\n"


def commands() -> str:
    """Return the page of every command, as its --help tells it."""
    from p2o.cli import group

    return "\n".join(["# Commands", "", *_helped(group, click.Context(group, info_name="p2o"), 2)])


def _helped(command: click.Command, context: click.Context, level: int) -> Iterator[str]:
    context.terminal_width = context.max_content_width = 100
    yield from (f"{'#' * level} {context.command_path}", "", "```text", command.get_help(context), "```", "")
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            inner = command.get_command(context, name)
            if inner is not None:
                made = click.Context(inner, info_name=name, parent=context)
                yield from _helped(inner, made, min(level + 1, 3))


def methods() -> str:
    """Return the page of every method that p2o brings, with its options, by kind."""
    from p2o.calibration.options import PipelineOptions
    from p2o.host.registry import Registry, requirement
    from p2o.host.slots import SLOT_OF

    registry = Registry.load(plugins=["p2o-calib"])
    text = ["# Methods", "", "What `p2o methods NAME` explains, of every method that comes with p2o.", ""]
    for kind in dict.fromkeys(offer.kind for offer in registry.offers):
        text += [f"## {kind.value.capitalize()}s", ""]
        for offer in registry.of_kind(kind):
            method = offer.method
            text += [
                f"### {method.name} {{#{kind.value.replace(' ', '-')}-{method.name}}}",
                "",
                _md(method.summary),
                "",
            ]
            facts = {
                "needs": ", ".join(f"`{word}`" for word in sorted(method.needs)),
                "gives": ", ".join(f"`{word}`" for word in sorted(method.gives)),
                "install": f"`pip install {requirement(offer)}`" if method.extra else "",
                "source": _md(method.cite),
            }
            text += [f"- {label}: {value}" for label, value in facts.items() if value]
            setting = SLOT_OF[offer.kind].setting(method.name, "NAME", "VALUE")
            text += ["", *_options(method.options, setting)]
            if method.trainer is not None:
                text += _options(method.trainer.options, f"p2o train {method.name} --set NAME=VALUE")
    text += ["## The pipeline", "", "The rounds that extractors, matcher, solver and init are run in.", ""]
    return "\n".join([*text, *_options(PipelineOptions, "--set pipeline.NAME=VALUE")])


def _options(model: Any, setting: str) -> Iterator[str]:
    from p2o.cli.methods import option_row

    rows = [option_row(name, field) for name, field in model.model_fields.items()]
    if rows:
        yield from (f"Options, `{setting}`:", "", "| option | default | type | meaning |", "|---|---|---|---|")
        yield from (f"| `{name}` | `{_cell(d)}` | {_md(t)} | {_md(about)} |" for name, d, t, about in rows)
        yield ""


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|") or '""'


def _md(text: str) -> str:
    return _cell(text).replace("<", "&lt;").replace("*", "\\*") if text else ""


def python() -> str:
    """Return the page of the author API: every public name with its signature and docstring."""
    import p2o

    text = ["# Python", "", "The author API. Arrays are NumPy's; poses are (4, 4), see conventions.", ""]
    for module in (p2o, p2o.solving, p2o.reading):
        text += [f"## Module {module.__name__}", "", inspect.getdoc(module) or "", ""]
        for name in sorted(module.__all__):
            value = getattr(module, name)
            signature = f"{module.__name__}.{name}{_signature(value)}"
            documented = inspect.ismodule(value) or inspect.isclass(value) or inspect.isfunction(value)
            about = (inspect.getdoc(value) or "") if documented else f"`{value!r}`"
            text += [f"### {name}", "", "```python", _wrapped(signature), "```", "", about.replace("<", "&lt;"), ""]
    return "\n".join(text)


def _signature(value: Any) -> str:
    """Return how a name is called; of a protocol, how what keeps it is called."""
    if getattr(value, "_is_protocol", False):
        value = vars(value).get("__call__")
    if inspect.ismodule(value) or value is None or (inspect.isclass(value) and issubclass(value, Enum)):
        return ""
    try:
        text = str(inspect.signature(value)).replace("(self, ", "(")
    except (TypeError, ValueError):
        return ""
    text = re.sub(r"((?:: |-> ))'([^']*)'", r"\1\2", text)  # annotations are texts
    return re.sub(r"<(?:function|object|class)[^>]*>", "...", text)


def _wrapped(signature: str) -> str:
    """Return a signature that is long with a parameter a line."""
    if len(signature) <= 100:
        return signature
    depth, out = 0, []
    for index, letter in enumerate(signature):
        depth += (letter in "([{") - (letter in ")]}")
        if letter == "(" and depth == 1:
            out.append("(\n    ")
        elif letter == ")" and depth == 0:
            out.append("\n)" if ")" not in signature[index + 1 :] else ")")
        elif letter == " " and depth == 1 and signature[index - 1] == ",":
            out.append("\n    ")
        else:
            out.append(letter)
    return "".join(out)
