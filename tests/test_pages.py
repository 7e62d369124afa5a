"""Every shell line and every Python block of README, CONTRIBUTING and docs is run, or checked as far as it can be.

A line is run on small synthetic frames (`page_data`) unless `ONLY_CHECKED` says why not. Then all its words are checked
by the command itself, which goes on to where it would read the first frame: names of methods, data, studies, protocols
and every option and value are right. A line of a program that nobody knows here fails.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import importlib
import importlib.util
import json
import re
import runpy
import shutil
import subprocess
import sys
import tomllib
import types
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

import click
import p2o
import pytest
from p2o.cli import group, main
from p2o.host import guard
from p2o.host.method import Kind
from p2o.host.slots import KIND_OF, SLOT_OF
from p2o.run.protocol import protocol_of
from p2o.run.recipe import dataset_part
from p2o_testing.cli import plugin_check

from tests.page_data import linked, written
from tests.pages import (
    LANGUAGES,
    PROGRAMS,
    ROOT,
    Command,
    blocks,
    inline_codes,
    pages,
    python_blocks,
    shell_blocks,
    text_of,
)

ELSEWHERE = {
    "docs/tutorial/first-calibration.md": "tests/test_tutorials.py",
    "docs/tutorial/first-day.md": "tests/test_tutorials.py",
    "docs/tutorial/first-plugin.md": "tests/test_tutorials.py",
    "docs/tutorial/first-study.md": "tests/test_tutorials.py",
    "docs/tutorial/your-own-frames.md": "tests/test_tutorials.py",
    "docs/how-to/fleet.md": "tests/test_fleet_page.py",
    "docs/how-to/published-network.md": "tests/p2o_study/test_external_files.py",
    "docs/how-to/ros-bag.md": "tests/test_ros_bag_page.py",
    "docs/how-to/several-lidars.md": "tests/test_rig_of_lidars_command.py",
}
"""Pages whose shell lines a test of their own runs, with what they print."""

ONLY_CHECKED = (
    (r"^(make|pip|cd)\b|^python -m (pytest|tests\.fuzz)", "it sets up or tests a whole machine"),
    (r"^python benchmarks/", "minutes to hours"),
    (r"^python -c .*build/data|build/data/|@baselines/.*splits|/data/kitti", "frames of KITTI or of other rigs"),
    (r"kitti-odometry:PATH", "frames of KITTI odometry"),
    (
        r"--calibrator (acsc|domhof|geiger|gong|koo|kuemmerle|mirzaei|pusztai|velas|velo2cam|zhou)",
        "tests/test_conformance.py, on frames with targets",
    ),
    (r"--(calibrator|init) matches", "tests/baselines/test_matches.py, with weights that the tests do not install"),
    (r"\b(argoverse2|kitti-360|once|pandaset|waymo):/", "tests/p2o_datasets/test_public_rigs.py, on small files"),
    (r"^(time )?p2o (ablate (?!--list)|compare)", "minutes to hours"),
    (r"^p2o benchmark ", "tests/p2o_study/test_benchmark*.py; it would write to the rows of the repository"),
    (r"^p2o report (out|p2o-out)", "it needs what such a study has left; the tutorial's is reported"),
    (r"^p2o (train|labels) p2ornet", "an hour"),
    (r"--rig around\.yaml", "tests/test_rig_solve.py, on the same rig"),
    (r"^p2o pick ", "somebody clicks"),
    (r"^p2o view ", "somebody looks; tests/test_view_page.py"),
    (r"--data DATA | COMMAND$| \.\.\.$", "it leaves words to the reader"),
    (r"^p2o train learned-steps|--set extractor\.weights=trained/", "tests/test_example_plugin.py, on whole frames"),
    (r"--watch", "minutes: more frames than 20"),
    (r"--init far", "half a minute; tests/toolkit/run/test_wide_search.py"),
    (r"^p2o plugin check", "tests/test_example_plugin.py, on the same file"),
)
"""What stands on lines that are not run, and why."""

SMALLER = (
    (r"^(p2o run --data folder:PATH)(?! --frames)", r"\1 --frames 0-1"),
    (r"folder:PATH", "kitti-raw:PATH"),  # frames of any layout
    (r"--frames 0,40\b", "--frames 0,4"),
    (r"--frames (0-9|0-23|30-39)\b", "--frames 0-1"),
    (r"kitti-raw:PATH --json", "kitti-raw:PATH --frames 0 --json"),
    (r"--most 24\b", "--most 4"),
    (r'(p2o run --data "synthetic:\?[^"]*)"', r'\1&width_px=320&height_px=120"'),
    (r"^p2o run( +#.*)?$", 'p2o run --data "synthetic:?width_px=320&height_px=120"'),
    (r"\bscenes=\d+", "scenes=1"),
    (r"--frames 2 ", ""),
    (r"^p2o doctor$", "p2o doctor --quick"),  # tests/test_doctor_command.py
    (r"&megapixels=1\b", "&megapixels=0.1"),
    (r"^(p2o run (?!.*--export-anyway).*--export .*)$", r"\1 --export-anyway"),  # small frames are doubtful
    (r"^(p2o simulate .*)$", r"\1 --set width_px=320 --set height_px=120"),
    (r"--set frames_per_scene=\d+", "--set frames_per_scene=2"),
)
"""What is made smaller, so that a line takes a second or two."""

NOT_EXECUTED = {
    'copytree("mine", "wrong")': "tests/test_tutorials.py runs it on recordings",
    'conformance_cases("my-distribution")': "there is no such distribution",
}
"""Python that is compiled, and its names of p2o looked up."""


RUN_BEFORE: set[str] = set()
"""Lines that were run on another page and write nothing that later lines read: each is run once."""


class Reached(KeyboardInterrupt):
    """A command has come to where it would read its first frame."""


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(tmp_path_factory.mktemp("pages"))


def why_only_checked(command: Command) -> str | None:
    """Return why a line is not run, None where it is."""
    return next((why for pattern, why in ONLY_CHECKED if re.search(pattern, command.text)), None)


def shell_pages() -> list[str]:
    return [page for page in pages() if shell_blocks(page) and page not in ELSEWHERE]


@pytest.mark.parametrize("page", pages())
def test_every_block_says_what_it_is(page: str) -> None:
    for block in blocks(page):
        assert block.language in ("", *LANGUAGES), f"{page}:{block.line}: which language is {block.language}?"
    for block in shell_blocks(page):
        for command in block.commands():
            assert command.words[0] in PROGRAMS, f"{command}: no shell line, or its program is not known here"


def test_pages_with_a_test_of_their_own_are_named_there() -> None:
    for page, test in ELSEWHERE.items():
        assert Path(page).stem in (ROOT / test).read_text(encoding="utf-8")


def test_every_reason_is_that_of_a_line() -> None:
    lines = [c.text for page in pages() for block in shell_blocks(page) for c in block.commands()]
    for pattern, why in ONLY_CHECKED:
        assert any(re.search(pattern, line) for line in lines), why


@pytest.mark.parametrize("page", shell_pages())
def test_the_shell_lines_of_a_page(
    page: str, world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(linked(world, tmp_path))
    monkeypatch.setenv("P2O_CACHE", str(tmp_path / "cache"))
    for block in python_blocks(page):
        # The paragraph above a block names the file that it is.
        above = text_of(page).partition(block.text)[0].rstrip().removesuffix("```python").rstrip().rpartition("\n\n")[2]
        for name in re.findall(r"`(\w+\.py)`", above):
            Path(name).write_text(block.text)
    for block in shell_blocks(page):
        for command in block.commands():
            if why_only_checked(command) is None:
                _run(command, capsys)
            else:
                _check(command, monkeypatch)
            capsys.readouterr()


def _run(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    """Run a line, smaller where it would take long."""
    text = command.text
    for pattern, less in SMALLER:
        text = re.sub(pattern, less, text)
    smaller = Command(command.page, command.line, text)
    program, *words = smaller.words
    if text in RUN_BEFORE:
        return
    if program == "p2o":
        if words[0] == "simulate":
            words.append("--force")
        status = main(words)
        said = capsys.readouterr()
        # A calibration or a choice of such small frames may be refused, or too doubtful: that is an answer, too.
        assert status in ((0, 1) if words[0] in ("run", "check", "data") else (0,)), f"{command}: {said.err}"
        assert "Traceback" not in said.err, command
        if command.target is not None:
            Path(command.target).write_text(said.out)
        elif words[0] != "simulate":
            RUN_BEFORE.add(text)
    elif program == "jq":
        _query(command)
    else:
        raise AssertionError(f"{command}: nobody knows how to run it")


def _query(command: Command) -> None:
    """Run jq; where it is not installed, the keys that a line names are those of the file."""
    words = command.words
    file = Path(words[-1])
    if not file.exists():
        data = "synthetic:?cameras=front,left&width_px=320&height_px=120&right=false&scenes=1"
        run = p2o.calibrate(data, extractor="depth/rings", rig="rig.yaml")
        file.write_text(json.dumps(run.as_dict()))
    if shutil.which("jq"):
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{command}: {done.stderr}"
        return
    keys = set(re.findall(r'"(\w+)":', file.read_text()))
    for name in re.findall(r"\.([a-z_]+)", words[-2]):
        assert name in keys, f"{command}: no {name} in the JSON of a run"


def _check(command: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    """Check all words of a line, without its work."""
    program, *words = command.words
    if program == "p2o":
        _check_p2o(command, words, monkeypatch)
    elif program == "python":
        _check_python(command, words, monkeypatch)
    elif program == "make":
        makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
        for word in words:
            name, equals, _ = word.partition("=")
            assert re.search(rf"^{name} \?=" if equals else rf"^{name}:", makefile, re.MULTILINE), command
    elif program == "pip":
        _check_install(command, words)
    elif program == "cd":
        # An earlier line of the page has made the folder.
        assert Path(words[0]).is_dir(), command
    else:
        raise AssertionError(f"{command}: nobody knows how to check it")


def _check_install(command: Command, words: list[str]) -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    written_by_p2o = [tomllib.loads(file.read_text()) for file in Path().glob("*/pyproject.toml")]
    for found in written_by_p2o:
        extras = {**extras, **found["project"].get("optional-dependencies", {})}
    known = {part for names in extras.values() for part in names}
    assert words[0] == "install", command
    for word in words[1:]:
        if word.startswith("-"):
            continue
        named = re.fullmatch(r"(?:\.|p2o-calib)(?:\[(.+)\])?", word)
        if named is None:
            assert word in known, f"{command}: no extra of p2o asks for {word}"
        elif named[1] is not None:
            assert set(named[1].split(",")) <= set(extras), command


def _check_p2o(command: Command, words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a command go on to its first frame; words that are left to the reader are left out."""
    from p2o_study import study as studies

    if words[:2] == ["plugin", "check"]:
        plugin_check.command.make_context(" ".join(words[:2]), words[2:])
        return
    if words[0] == "benchmark":
        benchmark: Any = group.get_command(click.Context(group), words[0])
        context = benchmark.get_command(click.Context(benchmark), words[1]).make_context(words[1], words[2:])
        suite = context.params.get("suite")
        assert suite is None or (ROOT / f"baselines/p2o_baselines/suites/{suite}.toml").is_file(), command
        return
    words = ["synthetic:" if word == "DATA" else word for word in words if word not in ("COMMAND", "...")]
    real_build = guard.build

    def no_frames(offer: Any, options: Any) -> Any:
        if offer.kind is Kind.DATASET:
            return _NoFrames()
        if offer.name == "matches":
            raise Reached  # its words are valid, and its weights are not installed for tests
        return real_build(offer, options)

    def planned(study: Any, folder: Any, *, plugins: Any, **_: Any) -> NoReturn:
        assert studies.check_study(study, plugins.registry())
        raise Reached

    with monkeypatch.context() as patch:
        patch.setenv("P2O_DEBUG", "1")
        patch.setattr(guard, "build", no_frames)
        patch.setattr("p2o_study.ablate.ablate", planned)
        patch.setattr("p2o_study.report.write_report", _reached)
        patch.setattr("p2o_pages.pick.server.PickServer", _reached)
        for name in ("DIR/rigs/waymo", "data/kitti"):
            Path(name).mkdir(parents=True, exist_ok=True)
        with _studies_of_the_example(command, patch):
            try:
                status = main(words)
            except Reached:
                return
        if status == 130 or (words[:2] == ["data", "list"] and status == 0):
            return  # interrupted by `Reached`; names are all that `data list` reads
        raise AssertionError(f"{command}: it ended before it came to its data")


@contextlib.contextmanager
def _studies_of_the_example(command: Command, patch: pytest.MonkeyPatch) -> Iterator[None]:
    """Let a study of the example plugin be found where a line names one."""
    if " example-gate " in command.text:
        example = ROOT / "tests/example_plugin"
        patch.syspath_prepend(str(example))
        patch.setattr("p2o_study.study.find_study", _found_in(example / "p2o_example/studies"))
        if "--update" not in command.text:
            Path("reference.json").write_text("{}")
            patch.setattr("p2o_study.gate.read_reference", lambda file: None)
    if "my.toml" in command.text:
        shutil.copy(ROOT / "tests/example_plugin/p2o_example/studies/example-gate.toml", "my.toml")
        text = Path("my.toml").read_text().replace("grey-steps/", "canny/").replace("gauss-newton", "lm")
        Path("my.toml").write_text(text)
    yield


def _found_in(folder: Path) -> Callable[..., Any]:
    def find(name: str, registry: Any) -> Any:
        from p2o_study.study import parse_study

        text = (folder / f"{name}.toml").read_text(encoding="utf-8")
        text = text.replace("grey-steps/", "canny/").replace('"gauss-newton"', '"lm"')
        return parse_study(text)

    return find


def _reached(*_: Any, **__: Any) -> NoReturn:
    raise Reached


class _NoFrames:
    """Names of as many frames as pages speak of; reading one ends the line."""

    names = (
        *(
            name
            for frames in json.loads((ROOT / "baselines/p2o_baselines/suites/splits.json").read_text()).values()
            for name in frames
        ),
        *(f"scene-{number:04}/000{frame}" for number in range(45) for frame in range(10)),
    )
    skipped: Mapping[str, str] = types.MappingProxyType({})

    def __len__(self) -> int:
        return len(self.names)

    def __getitem__(self, index: int) -> NoReturn:
        raise Reached


def _check_python(command: Command, words: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Parse the words of a script of benchmarks/ with its own parser, and look its data and methods up."""
    if words[0] == "-c":
        compile(words[1], str(command), "exec")
        return
    if words[0] == "-m":
        assert importlib.util.find_spec(words[1]) is not None, command
        if words[1] == "tests.fuzz":
            from tests.fuzz.__main__ import fuzz

            fuzz.make_context("fuzz", words[2:])
        return
    script = ROOT / words[0]
    assert script.is_file(), command
    found: list[argparse.Namespace] = []
    real = argparse.ArgumentParser.parse_args

    def parsed(self: argparse.ArgumentParser, *args: Any, **kwargs: Any) -> NoReturn:
        found.append(real(self, *args, **kwargs))
        raise Reached

    with monkeypatch.context() as patch:
        patch.setattr(sys, "argv", words)
        patch.syspath_prepend(str(script.parent))
        patch.setattr(argparse.ArgumentParser, "parse_args", parsed)
        if "argparse" in script.read_text(encoding="utf-8"):
            with pytest.raises(Reached):
                runpy.run_path(str(script), run_name="__main__")
    registry = p2o.Registry.load()
    for said in found:
        for name in filter(re.compile(r"[a-z0-9-]+:").match, _listed(getattr(said, "data", None))):
            dataset_part(name, registry)
        for pair in _listed(getattr(said, "extractor", None)) + _listed(getattr(said, "extractors", None)):
            for kind, name in zip((Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR), pair.split("/"), strict=False):
                registry.find(kind, name.partition("?")[0])
        for setting in _listed(getattr(said, "set", None) or getattr(said, "settings", None)):
            _check_setting(command, setting)


def _listed(value: Any) -> list[str]:
    if value is None:
        return []
    return [part for text in ([value] if isinstance(value, str | Path) else value) for part in str(text).split(",")]


@pytest.mark.parametrize("page", pages())
def test_commands_and_options_named_in_passing_are_there(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In `backticks` as well: commands, options, methods, data, protocols and --set."""
    for said in inline_codes(page):
        text = said.text
        if text.startswith("p2o "):
            _check_options(said)
        elif text.startswith("python benchmarks/"):
            assert (ROOT / text.split()[1]).is_file(), said
        elif text.startswith("make "):
            _check(said, monkeypatch)
        elif not text.startswith("--"):
            continue
        for setting in re.findall(r"--set \"?([a-z-]+\.[a-z_.]+)=", text):
            _check_setting(said, setting)
        for word, slot in (
            () if text.startswith("python") else ((slot.word, slot) for slot in SLOT_OF.values() if slot.in_recipe)
        ):
            for name in re.findall(rf"--{word} \"?([a-z0-9/@.-]+)", text):
                pair = word == "extractor" and "/" in name
                kinds = [slot.kind]
                if word == "extractor":
                    kinds = [Kind.IMAGE_EXTRACTOR, Kind.CLOUD_EXTRACTOR] if pair else [Kind.IMAGE_EXTRACTOR]
                for kind, part in zip(kinds, name.split("/") if pair else [name], strict=False):
                    assert not part or part in _names(kind) or part in _of_pages(), f"{said}: no {kind.value} {part}"
        for name in re.findall(r"--protocol ([a-z0-9-]+)", text):
            protocol_of(name)


@pytest.mark.parametrize("page", pages())
def test_methods_that_are_named_with_their_parts_fit_together(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as `--matcher gmm --solver coordinate`, which stands for a line of p2o run."""
    monkeypatch.chdir(tmp_path)
    for said in inline_codes(page):
        begins = re.match(r"--(extractor|matcher|solver|init|calibrator|accumulate|witness) ", said.text)
        left_to_the_reader = re.search(r"[A-Z]{3}|\.\.\.|\|", said.text)
        if begins and not left_to_the_reader:
            line = Command(page, said.line, f"p2o run --data kitti-raw:PATH {said.text}")
            _check_p2o(line, line.words[1:], monkeypatch)


def _check_options(said: Command) -> None:
    """Check that the command of a text is there, and every --option on it."""
    words = said.text.split()[1:]
    command: click.Command = group
    context = click.Context(group, info_name="p2o")
    while isinstance(command, click.Group) and words and re.fullmatch(r"[a-z][a-z-]*(\|[a-z][a-z-]*)*", words[0]):
        names = words.pop(0).split("|")
        for name in names:
            inner = command.get_command(context, name)
            assert inner is not None, f"{said}: no command {name}"
        command = inner
    known = {option for parameter in command.get_params(context) for option in parameter.opts}
    for option in re.findall(r"(?<!\S)(--[a-z-]+)", " ".join(words)):
        assert option in known, f"{said}: no option {option}"


def _check_setting(said: Command, setting: str) -> None:
    """Check that some method of the stage, or the pipeline, has the field."""
    from p2o.calibration.options import PipelineOptions

    stage, _, field = setting.partition("=")[0].partition(".")
    if stage == "pipeline":
        assert field in PipelineOptions.model_fields, f"{said}: the pipeline has no option {field}"
        return
    if stage == "augmentation":  # of training
        return
    stage = {"witness": "extractor", "witness-cloud": "cloud"}.get(stage, stage)
    assert stage in KIND_OF, f"{said}: no stage {stage}"
    offers = p2o.Registry.load().of_kind(KIND_OF[stage])
    first = field.partition(".")[0]
    assert any(first in offer.method.options.model_fields for offer in offers) or field in _OF_PAGES, (
        f"{said}: no {field}"
    )


def _names(kind: Kind) -> set[str]:
    return {offer.name for offer in p2o.Registry.load().of_kind(kind)} | {"none", "far"}


_OF_PAGES = ("threshold", "min_gap_m")
"""Options of plugins that the pages write, or let p2o write."""


def _of_pages() -> set[str]:
    """Return names of methods that the pages themselves make."""
    return set(re.findall(r'name="([a-z-]+)"', "".join(map(text_of, pages()))))


@pytest.mark.parametrize("page", [page for page in pages() if python_blocks(page)])
def test_the_python_of_a_page_runs(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its blocks, one after the other, as a reader would paste them into one session."""
    monkeypatch.chdir(tmp_path)
    session = types.ModuleType("page")
    monkeypatch.setitem(sys.modules, "page", session)  # dataclasses look there
    for block in python_blocks(page):
        code = compile(block.text, f"{page}:{block.line}", "exec")
        if any(text in block.text for text in NOT_EXECUTED):
            _look_up(block.text)
        else:
            exec(code, session.__dict__)  # noqa: S102  (our own documentation)


def _look_up(text: str) -> None:
    """Check that names which code imports from p2o are there."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("p2o"):
            module = importlib.import_module(str(node.module))
            for alias in node.names:
                assert hasattr(module, alias.name)


def test_python_that_is_not_executed_is_on_a_page() -> None:
    text = "".join(block.text for page in pages() for block in python_blocks(page))
    assert all(part in text for part in NOT_EXECUTED)
