"""Plugins are found, selected and kept apart when broken; methods are found by name (STYLE section 3)."""

from __future__ import annotations

import io
import os
import signal
import sys
import textwrap
import threading
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import InputError, Kind, Method, MethodUnavailable, PluginError, UnknownNameError
from p2o.host.guard import build
from p2o.host.registry import Offer, Registry, requirement

Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Install a distribution whose entry points are modules with the given source; ours are hidden meanwhile."""
    monkeypatch.syspath_prepend(str(tmp_path))
    modules_before = set(sys.modules)
    known: list[str] = []

    def add(dist: str, version: str = "1.0", **sources: str) -> None:
        info = tmp_path / f"{dist.replace('-', '_')}-{version}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {dist}\nVersion: {version}\n")
        lines = []
        for entry, source in sources.items():
            module = f"plug_{dist.replace('-', '_')}_{entry}"
            (tmp_path / f"{module}.py").write_text("import p2o\n" + textwrap.dedent(source))
            lines.append(f"{entry} = {module}")
        (info / "entry_points.txt").write_text("[p2o]\n" + "\n".join(lines) + "\n")
        known.append(dist)

    import p2o.host.registry as home

    real = home.entry_points
    monkeypatch.setattr(home, "entry_points", lambda group: [e for e in real(group=group) if e.dist.name in known])
    yield add
    for name in set(sys.modules) - modules_before:
        if name.startswith(("plug_", "p2o_plugin_file_")):
            del sys.modules[name]


def offers(name: str, hook: str = "p2o_matchers") -> str:
    return f"""
        @p2o.hookimpl
        def {hook}():
            yield p2o.Method(name="{name}", build=lambda options: (lambda *a: None), summary="A test.")
    """


def names(registry: Registry) -> list[str]:
    return [offer.full_name for offer in registry.offers]


def test_every_hook_offers_methods_of_its_kind(install: Install) -> None:
    install("acme", **{f"e{i}": offers(f"m{i}", kind.hook) for i, kind in enumerate(Kind)})
    registry = Registry.load(environ={})
    assert {offer.kind: offer.name for offer in registry.offers} == {kind: f"m{i}" for i, kind in enumerate(Kind)}
    assert len(Kind) == 10


def test_offers_know_who_offers_them_and_come_sorted_by_name(install: Install) -> None:
    # pluggy itself answers last-registered first; its own loader skips a second distribution with the entry `a`.
    install("zeta", "2.5", a=offers("delta"), b=offers("alpha"))
    install("alpha", z=offers("charlie"), a=offers("bravo"))
    registry = Registry.load(environ={})
    assert [plugin.name for plugin in registry.plugins] == ["alpha:a", "alpha:z", "zeta:a", "zeta:b"]
    last = registry.find(Kind.MATCHER, "delta")
    assert (last.dist, last.version, last.entry, last.full_name) == ("zeta", "2.5", "a", "delta@zeta")
    assert [offer.name for offer in registry.of_kind(Kind.MATCHER)] == ["alpha", "bravo", "charlie", "delta"]


BROKEN = {
    "import": "raise RuntimeError('no such luck')",
    "exit": "import sys\nsys.exit('no such luck')",
    "exit-0": "import sys\nsys.exit(0)",
    "generator-exit": "raise GeneratorExit('no such luck')",
    "cancelled": "import asyncio\n@p2o.hookimpl\ndef p2o_matchers():\n    raise asyncio.CancelledError('no such luck')",
    "hook": "@p2o.hookimpl\ndef p2o_matchers():\n    raise ValueError('no such luck')",
    # A generator raises when it is iterated, outside of the hook call and after it has offered something.
    "generator": f"{textwrap.dedent(offers('first'))}    raise ValueError('no such luck')",
    # pluggy leaves it half registered: the matcher would still be offered.
    "half": textwrap.dedent(offers("ghost")) + "@p2o.hookimpl\ndef p2o_solvers(x):\n    yield from ()",
    "not-iterable": "@p2o.hookimpl\ndef p2o_matchers():\n    return 3",
    "bare-method": (
        "@p2o.hookimpl\ndef p2o_matchers():\n    return p2o.Method(name='a', build=lambda o: o, summary='A test.')"
    ),
    "not-a-method": "@p2o.hookimpl\ndef p2o_matchers():\n    yield 'ogm'",
    "bad-slug": "@p2o.hookimpl\ndef p2o_matchers():\n    yield p2o.Method(name='O GM', build=lambda o: o, summary='A')",
    "twice": "@p2o.hookimpl\ndef p2o_matchers():\n    for _ in 'ab':\n"
    "        yield p2o.Method(name='a', build=lambda o: o, summary='A test.')",
    "unknown-hook": "@p2o.hookimpl\ndef p2o_martians():\n    yield from ()",
    "bad-arguments": "@p2o.hookimpl\ndef p2o_matchers(frames):\n    yield from ()",
}


@pytest.mark.parametrize("source", BROKEN.values(), ids=BROKEN)
def test_a_broken_plugin_costs_its_own_methods_only(
    install: Install, capsys: pytest.CaptureFixture[str], source: str
) -> None:
    install("aa-good", hooks=offers("before"))
    install("bad-one", "0.9", hooks=source)
    install("zz-good", hooks=offers("after"))
    registry = Registry.load(environ={})
    assert names(registry) == ["after@zz-good", "before@aa-good"]
    [broken] = registry.broken
    assert (broken.dist, broken.version, broken.entry) == ("bad-one", "0.9", "hooks")
    told = capsys.readouterr().err
    assert told == f"p2o: warning: plugin bad-one:hooks left out: {broken.error}\n"
    if "no such luck" in source:
        assert "no such luck" in broken.error


@pytest.mark.parametrize("source", BROKEN.values(), ids=BROKEN)
def test_strict_loading_raises_and_names_the_plugin(install: Install, source: str) -> None:
    install("bad-one", hooks=source)
    with pytest.raises(PluginError, match=r"cannot load plugin bad-one:hooks.*--block bad-one"):
        Registry.load(environ={"P2O_STRICT": "1"})


@pytest.mark.parametrize("version", ["2", "'1'"])
def test_a_plugin_of_another_api_version_is_refused_with_one_sentence(install: Install, version: str) -> None:
    """Before its hooks are called: they may use fields that this version does not have; hooks may be optional."""
    later = "@p2o.hookimpl(optionalhook=True)\ndef p2o_martians():\n    yield from ()\n"
    install(
        "future",
        plug=f"\nPLUGIN_API = {version}\n"
        + textwrap.dedent(offers("newer")).replace("yield", "yield p2o.NoSuchName or"),
    )
    install("current", plug="\nPLUGIN_API = 1\n" + textwrap.dedent(offers("stated")))
    install("silent", plug=later + textwrap.dedent(offers("unstated")))
    registry = Registry.load(environ={})
    assert names(registry) == ["stated@current", "unstated@silent"]
    (broken,) = registry.broken
    wanted = version.strip("'")
    assert broken.error == f"the plugin is written for plugin API {wanted}, but this p2o has plugin API 1"


def test_a_second_entry_point_of_one_name_is_told_and_the_first_stays(
    install: Install, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import p2o.host.registry as home

    install("one", hooks=offers("a"))
    real = home.entry_points
    monkeypatch.setattr(home, "entry_points", lambda group: [*real(group), *real(group)])
    registry = Registry.load(environ={})
    assert names(registry) == ["a@one"]
    assert "two plugins are called one:hooks" in registry.broken[0].error
    capsys.readouterr()


@pytest.mark.parametrize(
    ("allowed", "loaded"),
    [
        ("", []),
        (" , ", []),
        ("one", ["a@one"]),
        (" one , two:hooks ", ["a@one", "b@two"]),
        ("only", ["c@three"]),
        ("Two", ["b@two"]),
    ],
)
def test_p2o_plugins_names_the_only_ones_to_load(install: Install, allowed: str, loaded: list[str]) -> None:
    install("one", hooks=offers("a"))
    install("two", hooks=offers("b"))
    install("three", only=offers("c"))
    assert names(Registry.load(environ={"P2O_PLUGINS": allowed})) == loaded


def test_what_is_blocked_is_not_even_imported_and_unknown_plugins_are_errors(install: Install) -> None:
    install("noisy", hooks="raise RuntimeError")
    registry = Registry.load(block=["noisy"], environ={"P2O_STRICT": "1"})
    assert (registry.plugins, registry.broken, registry.blocked) == ((), (), ("noisy:hooks",))
    install("one", hooks=offers("a"))
    with pytest.raises(UnknownNameError, match=r"P2O_PLUGINS 'onee'.*did you mean one"):
        Registry.load(environ={"P2O_PLUGINS": "onee"})
    with pytest.raises(UnknownNameError, match="plugin to block 'tow'"):
        Registry.load(block=["tow"], environ={})


def test_a_file_is_one_plugin_and_one_module_until_it_is_edited(install: Install, tmp_path: Path) -> None:
    (tmp_path / "y").mkdir()
    file, again = tmp_path / "my_file.py", tmp_path / "y" / ".." / "my_file.py"
    file.write_text("import p2o\n" + textwrap.dedent(offers("mine")))

    def build_of_the_file() -> object:
        [offer] = Registry.load(extra_files=[file, again], environ={"P2O_PLUGINS": ""}).offers
        assert offer.full_name == "mine@my_file.py"
        return offer.method.build.__globals__  # type: ignore[attr-defined]

    first = build_of_the_file()
    assert build_of_the_file() is first
    file.write_text(file.read_text() + "\nEDITED = 1\n")
    assert build_of_the_file() is not first


def test_two_files_of_one_name_are_two_plugins(install: Install, tmp_path: Path) -> None:
    files = [tmp_path / folder / "x.py" for folder in ("a", "b")]
    for file, name in zip(files, ("left", "right"), strict=True):
        file.parent.mkdir()
        file.write_text(f"import p2o\nMINE = {name!r}\n" + textwrap.dedent(offers(name)))
    found = Registry.load(extra_files=files, environ={"P2O_PLUGINS": ""}).offers
    assert [offer.full_name for offer in found] == [f"left@{files[0]}", f"right@{files[1]}"]
    for offer in found:
        module = sys.modules[offer.method.build.__module__]
        assert (module.MINE, module.__dict__) == (offer.name, offer.method.build.__globals__)


def test_a_broken_file_is_an_error_since_somebody_asked_for_it(install: Install, tmp_path: Path) -> None:
    file = tmp_path / "my_file.py"
    file.write_text("import martians")
    with pytest.raises(PluginError, match=r"my_file.py.*No module named 'martians'.*correct"):
        Registry.load(extra_files=[file], environ={})
    with pytest.raises(PluginError, match="no such plugin file"):
        Registry.load(extra_files=[tmp_path / "absent.py"], environ={})


def test_a_clash_of_names_is_an_error_only_when_that_name_is_asked_for(install: Install) -> None:
    install("acme-p2o", hooks=offers("ogm") + offers("ogm", "p2o_solvers"))
    install("rival", hooks=offers("ogm"))
    registry = Registry.load(environ={})
    assert registry.find(Kind.SOLVER, "ogm").dist == "acme-p2o", "one name may mean methods of two kinds"
    assert [offer.kind for offer in registry.named("ogm")].count(Kind.MATCHER) == 2
    with pytest.raises(PluginError, match=r"acme-p2o:hooks and rival:hooks.*ogm@acme-p2o or ogm@rival"):
        registry.find(Kind.MATCHER, "ogm")
    assert registry.find(Kind.MATCHER, "ogm@acme-p2o").dist == "acme-p2o"
    assert registry.find(Kind.MATCHER, "ogm@Acme_P2O").dist == "acme-p2o"


def test_an_unknown_name_is_told_with_the_nearest_all_names_and_broken_plugins(install: Install) -> None:
    install("acme", hooks=offers("nearest"), more=offers("ogm"))
    install("bad-one", hooks="raise RuntimeError('no such luck')")
    registry = Registry.load(environ={})
    with pytest.raises(UnknownNameError) as caught:
        registry.find(Kind.MATCHER, "nearst")
    text = str(caught.value)
    assert "unknown matcher 'nearst'" in text
    assert "one of: nearest, ogm" in text
    assert "did you mean nearest?" in text
    assert "plugin bad-one:hooks is broken: RuntimeError: no such luck" in text


def test_our_own_methods_enter_by_the_same_entry_points() -> None:
    registry = Registry.load(environ={"P2O_STRICT": "1"})
    ours = {plugin.name for plugin in registry.plugins}
    assert {"p2o-calib:plugins", "p2o-calib:baselines"} <= ours
    assert registry.find(Kind.MATCHER, "ogm").dist == "p2o-calib"
    assert Registry.load(environ={"P2O_PLUGINS": ""}).offers == ()


# ---- guarded stages


def offer_of(kind: Kind, stage: object, **more: object) -> Offer:
    method = Method(name="fake", build=lambda options: stage, summary="A test.", **more)  # type: ignore[arg-type]
    return Offer(kind, method, "acme-p2o", "1.0", "hooks")


def test_what_a_stage_raises_names_plugin_and_stage_and_our_own_errors_pass_through_unchanged() -> None:
    def solve(problem: object, pose: object) -> None:
        raise ZeroDivisionError("by zero")

    stage = build(offer_of(Kind.SOLVER, solve), p2o.Options())
    with pytest.raises(PluginError, match=r"plugin acme-p2o: solver 'fake' raised ZeroDiv.*by zero") as raised:
        stage(None, np.eye(4))
    assert isinstance(raised.value.__cause__, ZeroDivisionError)
    mine = InputError("this sweep has no rings", where="sweep")

    def extract(cloud: object) -> None:
        raise mine

    with pytest.raises(InputError) as caught:
        build(offer_of(Kind.CLOUD_EXTRACTOR, extract), p2o.Options())(None)
    assert caught.value is mine


def test_the_state_of_the_process_stays_after_a_stage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def solve(problem: object, pose: np.ndarray) -> p2o.Solution:
        os.chdir("/")
        sys.setrecursionlimit(5000)
        sys.stdout = sys.stderr = io.StringIO()
        np.seterr(all="raise")
        warnings.simplefilter("error", SyntaxWarning)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        return p2o.Solution(pose, 0.0, 1)

    def state() -> tuple[object, ...]:
        streams, filters = (sys.stdout, sys.stderr), list(warnings.filters)
        handler = signal.getsignal(signal.SIGINT)
        return os.getcwd(), sys.getrecursionlimit(), streams, np.geterr(), filters, handler

    monkeypatch.chdir(tmp_path)
    before = state()
    build(offer_of(Kind.SOLVER, solve), p2o.Options())(None, np.eye(4))
    assert state() == before


def test_standard_output_is_opened_again_if_a_stage_closes_it(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def solve(problem: object, pose: np.ndarray) -> p2o.Solution:
        sys.stdout.close()
        return p2o.Solution(pose, 0.0, 1)

    with open(1, "w", encoding="ascii", errors="backslashreplace", closefd=False) as stdout:
        monkeypatch.setattr(sys, "stdout", stdout)
        build(offer_of(Kind.SOLVER, solve), p2o.Options())(None, np.eye(4))
    print("0.1 \N{DEGREE SIGN}")
    assert capfd.readouterr().out == "0.1 \\xb0\n"


def test_an_interruption_that_no_signal_can_raise_is_that_of_the_plugin(monkeypatch: pytest.MonkeyPatch) -> None:
    def solve(problem: object, pose: np.ndarray) -> p2o.Solution:
        raise KeyboardInterrupt

    stage = build(offer_of(Kind.SOLVER, solve), p2o.Options())
    with pytest.raises(KeyboardInterrupt):
        stage(None, np.eye(4))
    with ThreadPoolExecutor(1) as pool, pytest.raises(PluginError, match="'fake' raised KeyboardInterrupt"):
        pool.submit(stage, None, np.eye(4)).result()


def test_the_working_directory_is_restored_if_a_stage_removes_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def solve(problem: object, pose: np.ndarray) -> p2o.Solution:
        (tmp_path / "own").mkdir()
        os.chdir(tmp_path / "own")
        (tmp_path / "own").rmdir()
        return p2o.Solution(pose, 0.0, 1)

    monkeypatch.chdir(tmp_path)
    build(offer_of(Kind.SOLVER, solve), p2o.Options())(None, np.eye(4))
    assert os.getcwd() == str(tmp_path.resolve())


def test_streams_that_another_thread_redirects_for_its_call_are_restored_after_the_last_call() -> None:
    inside, done = threading.Event(), threading.Event()

    def redirecting(problem: object, pose: np.ndarray) -> p2o.Solution:
        with redirect_stdout(io.StringIO()):
            inside.set()
            done.wait(10)
        return p2o.Solution(pose, 0.0, 1)

    before = sys.stdout
    call = build(offer_of(Kind.SOLVER, redirecting), p2o.Options())
    thread = threading.Thread(target=call, args=(None, np.eye(4)))
    thread.start()
    inside.wait(10)
    build(offer_of(Kind.SOLVER, lambda _, pose: p2o.Solution(pose, 0.0, 1)), p2o.Options())(None, np.eye(4))
    done.set()
    thread.join()
    assert sys.stdout is before


@pytest.mark.parametrize("name", ["start_sigma", "reach"])
@pytest.mark.parametrize("sizes", [(2.0,), (2.0, -0.1), (np.nan, 0.1)])
def test_initial_errors_of_an_initializer_are_two_numbers_above_zero(sizes: tuple[float, ...], name: str) -> None:
    class Proposing(p2o.InitializerBase):
        def __call__(self, views: object, pose: object) -> list[object]:  # type: ignore[override]
            return [pose]

    setattr(Proposing, name, sizes)
    with pytest.raises(PluginError, match=rf"initializer 'fake': {name} is .*; expected degrees and metres"):
        build(offer_of(Kind.INITIALIZER, Proposing()), p2o.Options())


@pytest.mark.parametrize(
    ("missing", "extra", "dist", "message"),
    [
        ("no_such_package", "no-such-solver", "acme-p2o", r"no_such_package.*pip install no-such-solver"),
        ("kiss_icp", "gicp", "p2o-calib", 'pip install "kiss-icp>='),
    ],
)
def test_a_missing_package_is_told_with_the_pip_command(missing: str, extra: str, dist: str, message: str) -> None:
    """By its own name where it is of another extra, and never as an extra of our distribution, which is on no index."""

    def import_it(options: object) -> None:
        raise ModuleNotFoundError(f"No module named '{missing}'", name=missing)

    method = Method(name="fake", build=import_it, summary="A test.", extra=extra)
    with pytest.raises(MethodUnavailable, match=message):
        build(Offer(Kind.SOLVER, method, dist, "1.0", "hooks"), p2o.Options())
    ceres = Registry.load(environ={}).find(Kind.SOLVER, "ceres")
    assert requirement(ceres) == '"pyceres>=2.4"'


class _Frames(list):  # type: ignore[type-arg]
    def __init__(self, frames: list[object], names: list[str]) -> None:
        super().__init__(frames)
        self.names = names


def test_a_dataset_is_checked_as_it_is_read_and_a_full_disk_is_an_input_error_of_the_exporter() -> None:
    def opened(frames: list[object], names: list[str]) -> object:
        return build(offer_of(Kind.DATASET, _Frames(frames, names)), p2o.Options())

    with pytest.raises(PluginError, match="two frames are called 'a'"):
        opened([1, 2], ["a", "a"])
    with pytest.raises(PluginError, match="1 names for 2 frames"):
        opened([1, 2], ["a"])
    with pytest.raises(PluginError, match=r"frame 1 is int; expected p2o\.Frame"):
        opened([1, 2], ["a", "b"])[1]  # type: ignore[index]
    for kind, built, name in ((Kind.DATASET, [1, 2], "list"), (Kind.SOLVER, 3, "int")):
        with pytest.raises(PluginError, match=f"build returned {name}"):
            build(offer_of(kind, built), p2o.Options())

    def export(result: object, path: object) -> None:
        raise OSError(28, "No space left on device", str(path))

    with pytest.raises(InputError, match=r"/out\.json: exporter 'fake' failed.*No space left on device"):
        build(offer_of(Kind.EXPORTER, export), p2o.Options())(None, "/out.json")
