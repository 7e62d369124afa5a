"""The plugin host: finds plugins, lists the methods they offer, and keeps what is broken apart with its reason.

Loading is a call, never an effect of an import. Plugins are entry points of the group "p2o" (or single files); each
is loaded in its own `try`, so a broken one costs its own methods and nothing else.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import re
import signal
import sys
import threading
import warnings
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError, entry_points, requires
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import pluggy

from p2o.errors import (
    LONGEST,
    InputError,
    MethodUnavailable,
    P2OError,
    PluginError,
    Terminated,
    UnknownNameError,
    one_line,
    terminate,
)
from p2o.files.input_file import MAX_TEXT_BYTES, expanded, read_bytes
from p2o.host import hookspecs
from p2o.host.method import PLUGIN_API, Kind, Method
from p2o.host.method_index import changed
from p2o.host.slots import SLOT_OF

if TYPE_CHECKING:
    from packaging.requirements import Requirement

GROUP = "p2o"
DISTRIBUTION = "p2o-calib"
"""The distribution of this package and its own plugins."""


@dataclass(frozen=True)
class Offer:
    """One method with the plugin that offers it; `dist` is the distribution (or file), `entry` its entry point."""

    kind: Kind
    method: Method
    dist: str
    version: str
    entry: str

    @property
    def name(self) -> str:
        """Name of the method."""
        return self.method.name

    @property
    def full_name(self) -> str:
        """The name that decides between two offers of one name: method@distribution."""
        return f"{self.method.name}@{self.dist}"


@dataclass(frozen=True)
class _Origin:
    """Where a plugin comes from: distribution (or file), its version, and the entry point."""

    dist: str
    version: str
    entry: str

    @property
    def name(self) -> str:
        """Its name in the registry: distribution:entry."""
        return f"{self.dist}:{self.entry}"


@dataclass(frozen=True)
class Plugin(_Origin):
    """One plugin that was loaded, with the methods it offers."""

    offers: tuple[Offer, ...] = ()


@dataclass(frozen=True)
class Broken(_Origin):
    """One plugin that could not be loaded, and why in one line."""

    error: str


@dataclass(frozen=True)
class _Source(_Origin):
    """A plugin before it is loaded: an object, an entry point or a file."""

    value: Any
    forced: bool = False

    def answers_to(self, word: str) -> bool:
        """True where the user means this plugin by `word`: its distribution, entry point, or both."""
        return word in (self.name, self.entry) or _slug(word) == _slug(self.dist)

    def load(self) -> Any:
        if isinstance(self.value, EntryPoint):
            return self.value.load()
        return _module_of(self.value) if isinstance(self.value, Path) else self.value


@dataclass(frozen=True)
class Registry:
    """Every method that can be used, found by kind and name; `plugins` in the order they were loaded.

    Make one with `Registry.load()`, or with `Registry.of(...)` from plugin objects in tests and scripts.
    """

    plugins: tuple[Plugin, ...] = ()
    broken: tuple[Broken, ...] = ()
    blocked: tuple[str, ...] = field(default=())

    @classmethod
    def load(
        cls,
        plugins: Iterable[str] | None = None,
        block: Iterable[str] = (),
        extra_files: Iterable[str | Path] = (),
        environ: Mapping[str, str] | None = None,
    ) -> Registry:
        """Load the plugins that are installed, in the order of their names.

        `plugins` names the only ones to load (default: the comma-separated `P2O_PLUGINS` of `environ`; unset: all,
        empty: none), `block` ones to leave out; a name is a distribution, an entry point, or distribution:entry.
        `extra_files` are Python files that are always loaded in addition. A broken plugin is skipped with one line on
        stderr; with `P2O_STRICT=1` it raises.

        Raises UnknownNameError for a plugin that is not installed, and PluginError for a broken file of
        `extra_files` (requested explicitly) or, when strict, for any broken plugin.
        """
        environ = os.environ if environ is None else environ
        if plugins is None and "P2O_PLUGINS" in environ:
            plugins = environ["P2O_PLUGINS"].split(",")
        installed = _installed()
        chosen, blocked = _selected(installed, plugins, block)
        files = _file_sources(extra_files)
        return cls._from([*chosen, *files], blocked, strict=environ.get("P2O_STRICT", "") not in ("", "0"))

    @classmethod
    def of(cls, *plugins: object, **named: object) -> Registry:
        """Return a registry of plugin objects (modules, classes or instances with hook implementations).

        Keyword arguments name the distribution a plugin counts as; others are called by their own name. A broken
        plugin raises PluginError.
        """
        sources = [_Source(getattr(p, "__name__", type(p).__name__), "", str(i), p) for i, p in enumerate(plugins)]
        sources += [_Source(name.replace("_", "-"), "", "plugin", p) for name, p in named.items()]
        return cls._from(sources, (), strict=True)

    @classmethod
    def of_process(cls) -> Registry:
        """Return the installed plugins, loaded once, and the plugin files that this process has loaded without error.

        For code without access to the registry of a run, e.g. data sets that read calibration files.
        """
        installed = _installed_registry(os.environ.get("P2O_PLUGINS"))
        return replace(installed, plugins=(*installed.plugins, *_file_plugins.values()))

    @classmethod
    def _from(cls, sources: Sequence[_Source], blocked: Sequence[str], *, strict: bool) -> Registry:
        host = pluggy.PluginManager(hookspecs.PROJECT)
        host.add_hookspecs(hookspecs)
        good: list[Plugin] = []
        bad: list[Broken] = []
        names: set[str] = set()
        for source in sources:
            try:
                if source.name in names:
                    raise PluginError(f"two plugins are called {source.name}", expected="one entry point of a name")
                with _same_process():
                    good.append(_register(host, source))
                if isinstance(source.value, Path):
                    _file_plugins[source.value.resolve()] = good[-1]
            # A plugin that calls sys.exit() on import must not end the program that only lists it.
            except BaseException as problem:
                if _by_user(problem):
                    raise
                # pluggy keeps a plugin that fails validation half registered: its other hooks would still answer.
                if source.name not in names and host.has_plugin(source.name):
                    host.unregister(name=source.name)
                reason = _one_line(problem)
                if strict or source.forced:
                    text, hint = f"cannot load plugin {source.name}", _repair_hint(source)
                    raise PluginError(text, got=reason, hint=hint) from problem
                bad.append(Broken(source.dist, source.version, source.entry, reason))
                print(f"p2o: warning: plugin {source.name} left out: {reason}", file=sys.stderr)
            names.add(source.name)
        return cls(tuple(good), tuple(bad), tuple(blocked))

    @cached_property
    def offers(self) -> tuple[Offer, ...]:
        """Every offer, by kind, then name, then distribution."""
        order = {kind: i for i, kind in enumerate(Kind)}
        offers = [offer for plugin in self.plugins for offer in plugin.offers]
        return tuple(sorted(offers, key=lambda o: (order[o.kind], o.name, o.dist, o.entry)))

    def of_kind(self, kind: Kind) -> tuple[Offer, ...]:
        """Return every offer of a kind, by name."""
        return tuple(offer for offer in self.offers if offer.kind == kind)

    def named(self, name: str) -> tuple[Offer, ...]:
        """Return the offers of all kinds that `name` (or name@distribution) means.

        Raises UnknownNameError where there are none.
        """
        offers = tuple(o for o in self.offers if _matches(o, name))
        if not offers:
            raise UnknownNameError("method", name, {o.name for o in self.offers}, hint=self._broken_hint())
        return offers

    def find(self, kind: Kind, name: str) -> Offer:
        """Return the one offer of a kind with this exact name; `name@distribution` decides between two.

        Raises UnknownNameError with the nearest names, all names of the kind, and the broken plugins with their
        reasons; PluginError where two plugins offer the name, naming both.
        """
        offers = [offer for offer in self.of_kind(kind) if _matches(offer, name)]
        if not offers:
            known = {o.full_name if "@" in name else o.name for o in self.of_kind(kind)}
            hint = "; ".join(filter(None, (self._other_kind(name), self._broken_hint())))
            raise UnknownNameError(kind.value, name, known, hint=hint)
        if len(offers) > 1:
            givers = " and ".join(f"{o.dist}:{o.entry}" for o in offers)
            text = f"{kind.value} '{name}' is offered by two plugins: {givers}"
            names = " or ".join(sorted({o.full_name for o in offers}))
            raise PluginError(text, hint=f"write {names}, or leave one out with --block")
        return offers[0]

    def _other_kind(self, name: str) -> str:
        """Return how a method of this name but of another kind is selected, else an empty text."""
        offer = next((offer for offer in self.offers if _matches(offer, name)), None)
        if offer is None:
            return ""
        slot = SLOT_OF[offer.kind]
        option = f"{slot.option} {slot.spec(name, {'extractor': 'IMAGE', 'cloud': 'CLOUD'})}"
        return f"{name} is a method of another kind, {offer.kind}: {option}"

    def _broken_hint(self) -> str:
        hints = [f"plugin {b.name} is broken: {b.error}" for b in self.broken]
        if self.blocked:
            hints.append("left out on request: " + ", ".join(self.blocked))
        return "; ".join(hints)


_file_plugins: dict[Path, Plugin] = {}
"""The plugins of single files that this process has loaded, by path."""


@cache
def _installed_registry(selection: str | None) -> Registry:
    """Return the registry of the installed plugins; `selection` is P2O_PLUGINS."""
    return Registry.load(None if selection is None else selection.split(","))


@cache
def plugin_packages() -> frozenset[str]:
    """Return the top-level packages that p2o and the installed plugins are in."""
    return frozenset({"p2o", *(entry.module.partition(".")[0] for entry in entry_points(group=GROUP))})


def _matches(offer: Offer, name: str) -> bool:
    bare, at, dist = name.partition("@")
    return offer.name == bare and (not at or _slug(dist) == _slug(offer.dist))


def _slug(name: str) -> str:
    """Return a distribution name in its normal form (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name.strip()).lower()


def _one_line(problem: BaseException) -> str:
    text = one_line(problem, LONGEST)
    return text if isinstance(problem, P2OError) else f"{type(problem).__name__}{': ' * bool(text)}{text}"


def _repair_hint(source: _Source) -> str:
    if isinstance(source.value, Path):
        return f"correct {source.value}"
    return f"leave it out with --block {source.dist}" if isinstance(source.value, EntryPoint) else "correct the plugin"


def _installed() -> list[_Source]:
    """Return the entry points of the group, sorted by distribution and name."""
    # pluggy's own loader skips a second entry point of one name; reading the group ourselves keeps both.
    sources = []
    # Metadata contain the README: they are parsed once for a distribution.
    known: dict[Distribution | None, tuple[str, str]] = {None: ("unknown", "")}
    for entry in entry_points(group=GROUP):
        if entry.dist is not None and entry.dist not in known:
            metadata = entry.dist.metadata
            known[entry.dist] = metadata["Name"], metadata["Version"]
        name, version = known[entry.dist]
        # Where the package importlib_metadata is imported, it gives entry points of a class of its own.
        plain = EntryPoint(entry.name, entry.value, entry.group)
        sources.append(_Source(_slug(name), version, entry.name, plain))
    return sorted(sources, key=lambda s: (s.name, s.value.value))


def _file_sources(paths: Iterable[str | Path]) -> list[_Source]:
    """Return the sources of plugin files, each file once; those that share a name are called by their paths."""
    files = {path.resolve(): path for path in map(expanded, paths)}
    count = Counter(path.name for path in files.values())
    names = {path: path.name if count[path.name] == 1 else str(path) for path in files.values()}
    return [_Source(name, "", path.stem, path, forced=True) for path, name in names.items()]


def _selected(
    installed: Sequence[_Source], only: Iterable[str] | None, block: Iterable[str]
) -> tuple[list[_Source], list[str]]:
    """Return what to load and the names of what is left out."""
    wanted = None if only is None else [word.strip() for word in only if word.strip()]
    unwanted = [word.strip() for word in block if word.strip()]
    for label, words in (("plugin in P2O_PLUGINS", wanted or []), ("plugin to block", unwanted)):
        for word in words:
            if not any(source.answers_to(word) for source in installed):
                raise UnknownNameError(label, word, {s.dist for s in installed} | {s.name for s in installed})
    chosen, left_out = [], []
    for source in installed:
        allowed = wanted is None or any(source.answers_to(word) for word in wanted)
        if allowed and not any(source.answers_to(word) for word in unwanted):
            chosen.append(source)
        else:
            left_out.append(source.name)
    return chosen, left_out


_loaded: dict[str, tuple[Path, bytes]] = {}
"""File and content of the modules that were made of single files, by name."""


def file_module_name(path: Path) -> str:
    """Return what the module of a single file is called: two files of one name are two modules."""
    # The same in every process that loads this file: what one of them keeps, the others find again.
    return f"p2o_plugin_file_{path.stem}_{hashlib.sha256(os.fsencode(path.resolve())).hexdigest()[:8]}"


def _module_of(path: Path) -> Any:
    """Import one file as a module of its own; unchanged files keep their module, which identifies their classes."""
    if not path.is_file():
        raise InputError("no such plugin file", where=path, expected="a Python file")
    state = path.resolve(), read_bytes(path, "plugin file", MAX_TEXT_BYTES)
    name = file_module_name(path)
    if name in sys.modules and _loaded.get(name) == state:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise InputError("the plugin file is not Python", where=path, expected="a name that ends in .py")
    module = importlib.util.module_from_spec(spec)
    # dataclasses and pydantic look their module up while classes are made.
    sys.modules[spec.name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[spec.name]
        raise
    _loaded[name] = state
    return module


def _register(host: pluggy.PluginManager, source: _Source) -> Plugin:
    """Register one plugin and list its methods while we still know whose they are."""
    module = source.load()
    api = getattr(module, "PLUGIN_API", PLUGIN_API)
    if api != PLUGIN_API:
        raise PluginError(f"the plugin is written for plugin API {api}, but this p2o has plugin API {PLUGIN_API}")
    host.register(module, name=source.name)
    host.check_pending()
    others = [plugin for plugin in host.get_plugins() if plugin is not module]
    offers: list[Offer] = []
    for kind in Kind:
        # Called through pluggy, so that a hook may gain arguments without breaking old plugins.
        for result in host.subset_hook_caller(kind.hook, others)():
            if isinstance(result, Method) or not isinstance(result, Iterable):
                wanted = "an iterable of p2o.Method: yield them"
                raise PluginError(f"{kind.hook} returned {type(result).__name__}", expected=wanted)
            # A generator raises only here, outside of the hook call.
            for method in result:
                if not isinstance(method, Method):
                    raise PluginError(f"{kind.hook} offered {type(method).__name__}", expected="p2o.Method")
                if any(o.kind == kind and o.name == method.name for o in offers):
                    raise PluginError(f"{kind.hook} offers '{method.name}' twice", expected="each name once")
                if kind is Kind.DATASET:
                    method = changed(method, _with_sparse_options)
                offers.append(Offer(kind, method, source.dist, source.version, source.entry))
    return Plugin(source.dist, source.version, source.entry, tuple(offers))


def _with_sparse_options(method: Method) -> Method:
    from p2o.frames.sparse import with_sparse_options

    return replace(method, options=with_sparse_options(method.options))


def fault(offer: Offer, what: str, expected: object = None) -> PluginError:
    """Return the error that names plugin, slot and method, and what is wrong with a returned value."""
    return PluginError(f"plugin {offer.dist}: {offer.kind} '{offer.name}': {what}", expected=expected)


@contextmanager
def watch(offer: Offer, doing: str) -> Iterator[None]:
    """Turn exceptions of a plugin into a PluginError that names it; P2OError and Ctrl-C pass unchanged.

    SystemExit and other classes that do not derive from Exception are faults, too: they would end the program. A
    missing package becomes MethodUnavailable, and an OSError of a data set or exporter an InputError with the file.
    """
    try:
        with (
            _same_process(),
            _reported(f"plugin {offer.dist}: {offer.kind} '{offer.name}' ended its process while {doing}"),
        ):
            yield
    except P2OError:
        raise
    except ModuleNotFoundError as problem:
        raise _unavailable(offer, problem) from problem
    except OSError as problem:
        if offer.kind in (Kind.DATASET, Kind.EXPORTER):
            text = f"{offer.kind} '{offer.name}' failed while {doing}"
            raise InputError(text, where=problem.filename, got=problem.strerror or one_line(problem)) from problem
        raise _raised(offer, doing, problem) from problem
    except BaseException as problem:
        if _by_user(problem):
            raise
        raise _raised(offer, doing, problem) from problem


def _by_user(problem: BaseException) -> bool:
    """Return whether Ctrl-C or another signal may have raised an exception during a call of a plugin.

    Where Ctrl-C raises Terminated or is ignored, and in threads, which receive no signals, a plugin raises a plain
    KeyboardInterrupt.
    """
    if isinstance(problem, Terminated):
        return True
    if not isinstance(problem, KeyboardInterrupt):
        return False
    in_main_thread = threading.current_thread() is threading.main_thread()
    return in_main_thread and signal.getsignal(signal.SIGINT) not in (signal.SIG_IGN, terminate)


@contextmanager
def _same_process() -> Iterator[None]:
    """Restore the state of the process that other methods depend on, such as the working directory.

    A process that a plugin has forked and that returns from the call ends here: it would repeat the rest of the work.
    """
    process = os.getpid()
    limit = sys.getrecursionlimit()
    folder = _working_directory()
    on_interrupt = signal.getsignal(signal.SIGINT)
    numpy = sys.modules.get("numpy")
    with _streams_and_warnings(), nullcontext() if numpy is None else numpy.errstate():
        try:
            yield
        finally:
            if os.getpid() != process:
                text = b"p2o: warning: ended a process that a plugin had forked and that returned from its call\n"
                os.write(2, text)
                os._exit(1)
            if sys.getrecursionlimit() != limit:
                sys.setrecursionlimit(limit)
            if folder and _working_directory() != folder:
                os.chdir(folder)
            if signal.getsignal(signal.SIGINT) is not on_interrupt:
                with suppress(ValueError, TypeError):  # in another thread, or it was a handler of C code
                    signal.signal(signal.SIGINT, on_interrupt)


_states: list[tuple[Any, Any, list[Any]]] = []
"""Streams and warning filters at the beginning of each running call of a plugin, in all threads."""
_states_lock = threading.Lock()


@contextmanager
def _streams_and_warnings() -> Iterator[None]:
    """Restore `sys.stdout` and `sys.stderr` and remove new filters that raise warnings, when no call is running.

    Threads share them: another thread may have redirected them for the duration of its own call.
    """
    with _states_lock:
        _states.append((sys.stdout, sys.stderr, _raising_filters()))
    try:
        yield
    finally:
        with _states_lock:
            stdout, stderr, raising = _states[0]
            _states.pop()
            if not _states:
                sys.stdout, sys.stderr = _opened(stdout, 1), _opened(stderr, 2)
                if any(entry not in raising for entry in _raising_filters()):
                    kept = [entry for entry in warnings.filters if entry[0] != "error" or entry in raising]
                    warnings.resetwarnings()
                    list.extend(cast(Any, warnings.filters), kept)


def _opened(stream: Any, descriptor: int) -> Any:
    """Return a stream, or a new one of its descriptor if a plugin has closed it."""
    if not getattr(stream, "closed", False):
        return stream
    return open(descriptor, "w", buffering=1, encoding=stream.encoding, errors=stream.errors, closefd=False)


def _raising_filters() -> list[Any]:
    return [entry for entry in warnings.filters if entry[0] == "error"]


def _working_directory() -> str:
    """Return the working directory, an empty text if it was removed."""
    try:
        return os.getcwd()
    except FileNotFoundError:
        return ""


_reports: list[Callable[[str], object]] = []
"""Receives the running call of a plugin, for a process that watches this one; at most one."""
_running: list[str] = []


@contextmanager
def _reported(call: str) -> Iterator[None]:
    if not _reports:
        yield
        return
    _running.append(call)
    _reports[0](call)
    try:
        yield
    finally:
        _running.pop()
        _reports[0](_running[-1] if _running else "")


@contextmanager
def reported_calls(report: Callable[[str], object]) -> Iterator[None]:
    """Report the running call of a plugin when it changes, for a process that watches this one."""
    _reports.append(report)
    try:
        yield
    finally:
        _reports.clear()


def requirement(offer: Offer) -> str:
    """Return the packages that pip has to install for a method, such as "pyceres>=2.4"; empty if none is needed.

    These are the packages of the extra of the method's distribution: the distribution itself may be on no index.
    """
    extra = offer.method.extra
    packages = [f'"{package}"' for package in requirements(offer.dist, extra)] if extra else []
    return " ".join(packages) or extra


def requirements(dist: str, extra: str = "") -> list[Requirement]:
    """Return the packages that an extra of a distribution requires, or the distribution itself, without markers."""
    from packaging.requirements import InvalidRequirement, Requirement

    try:
        packages = [Requirement(text) for text in requires(dist) or []]
    except (PackageNotFoundError, InvalidRequirement):
        return []
    required = []
    for package in packages:
        marker, package.marker = package.marker, None
        of_extra = marker is not None and "extra" in str(marker)
        if of_extra == bool(extra) and (marker is None or marker.evaluate({"extra": extra})):
            required.append(package)
    return required


def _raised(offer: Offer, doing: str, problem: BaseException) -> PluginError:
    text = f"plugin {offer.dist}: {offer.kind} '{offer.name}' raised {type(problem).__name__} while {doing}"
    return PluginError(text, got=one_line(problem) or None, hint="P2O_DEBUG=1 shows where")


def _unavailable(offer: Offer, problem: ModuleNotFoundError) -> P2OError:
    missing = (problem.name or "").partition(".")[0]
    if missing == getattr(offer.method.build, "__module__", "").partition(".")[0]:
        return _raised(offer, "importing its own code", problem)
    text = f"{offer.kind} '{offer.name}' needs the package {missing}, which is not installed"
    return MethodUnavailable(
        text, hint=f"run: pip install {requirement_named(missing, offer.dist) or requirement(offer) or missing}"
    )


def requirement_named(module: str, dist: str) -> str:
    """Return the requirement of a distribution, or of any of its extras, that has the name of a module, in quotes."""
    try:
        texts = [text.partition(";")[0].strip() for text in requires(dist) or []]
    except PackageNotFoundError:
        return ""
    same = re.compile(re.escape(module).replace("_", "[_-]") + r"(?![\w.-])", re.IGNORECASE)
    return next((f'"{text}"' for text in texts if same.match(text)), "")
