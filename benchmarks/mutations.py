"""The share of deliberate faults that `make test` catches.

    python benchmarks/mutations.py --out build/mutations.jsonl
    python benchmarks/mutations.py --check                    # only whether every fault can be injected

Each fault of `faults.toml` replaces one text in a copy of the tree: a flipped sign, swapped axes, a dropped guard,
leaked ground truth, in all rooms and packages. Stage 1 runs the nearest tests: files named after the module, files that
import it, and if these are few, files of the same room. Stage 2 runs all other tests of `make test`, if stage 1 passes.
Tests that also fail without the fault do not count.

Exit status: 0 if all faults were tried, 2 if a text to replace is not there exactly once, with one line for each. The
interpreter needs the packages of requirements.lock and the tree's distribution, whose entry points name the plugins.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path

from limits_and_tables import add_row, table

_SOURCES = ("toolkit", "plugins", "baselines")
_MOST_IMPORTERS, _FEW = 8, 3
"""Most test files of stage 1 beside those named after the module; below `_FEW` in all, files of its room fill up."""
_LIMITS_S = (1800.0, 4 * 3600.0)
"""Time limits of the two stages: a fault that makes the tests hang is caught."""
_FAILED = re.compile(r"^(?:FAILED|ERROR) (tests/\S+?\.py(?:::.+?)?)(?: - .*)?$", re.MULTILINE)


@dataclass(frozen=True)
class Mutation:
    """A fault: `find` becomes `replace` in the file `path`."""

    name: str
    kind: str
    path: str
    find: str
    replace: str

    def mismatch(self, tree: Path) -> str:
        """Return why the fault cannot be injected into a tree, "" if it can."""
        if not (tree / self.path).is_file():
            return f"{self.name}: {self.path}: no such file"
        count = (tree / self.path).read_text(encoding="utf-8").count(self.find)
        if count != 1:
            return f"{self.name}: {self.path}: the text is there {count} times instead of once: {self.find}"
        return "" if self.find != self.replace else f"{self.name}: the replacement is the same text"


MUTATIONS = tuple(
    Mutation(name, **values)
    for name, values in tomllib.loads(Path(__file__).with_name("faults.toml").read_text(encoding="utf-8")).items()
)


@dataclass
class Outcome:
    """The outcome of a fault: caught, survived, or void if tests also fail without it."""

    name: str
    kind: str
    path: str
    outcome: str = ""
    stage: int = 0
    test: str = ""
    seconds: float = 0.0
    stage_1: list[str] = field(default_factory=list)


def test_files(tree: Path) -> list[str]:
    """Return the paths of all test files of a tree."""
    return sorted(path.relative_to(tree).as_posix() for path in (tree / "tests").rglob("test_*.py"))


def module_of(path: str) -> str:
    """Return the dotted name of a source file such as toolkit/p2o/geometry/se3.py."""
    return ".".join(Path(path).with_suffix("").parts[1:]).removesuffix(".__init__")


def imported(source: str) -> Counter[str]:
    """Return how often a source text names modules in its imports: `from a.b import c` names a.b and a.b.c."""
    names: Counter[str] = Counter()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
    return names


def nearest_tests(tree: Path, path: str) -> list[str]:
    """Return the test files of stage 1: those named after the module, then some of those that import it."""
    module = module_of(path)
    stem = module.rpartition(".")[2]
    files = test_files(tree)
    named = [file for name in (f"test_{stem}", f"test_{stem}_command") for file in files if Path(file).stem == name]
    counts = {file: imported((tree / file).read_text(encoding="utf-8"))[module] for file in files if file not in named}
    importers = sorted((file for file, count in counts.items() if count), key=lambda file: (-counts[file], file))
    near = named + importers[:_MOST_IMPORTERS]
    folders = set(Path(path).parent.parts[-1:])
    room = [file for file in counts if file not in near and folders & set(Path(file).parent.parts)]
    return near if len(near) >= _FEW else near + room[: _MOST_IMPORTERS - len(near)]


def copied(tree: Path, to: Path) -> Path:
    """Copy the tracked files of a tree, and link its ignored folder build, which has the real frames."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=tree, capture_output=True, check=True).stdout.decode()
    for name in filter(None, listed.split("\0")):
        if (tree / name).is_file():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(tree / name, to / name)
    if (tree / "build").exists():
        (to / "build").symlink_to((tree / "build").resolve())
    return to


def environment(tree: Path, folder: Path) -> dict[str, str]:
    """Return the environment of tests: the sources of the tree before those of the distribution, no kept features."""
    paths = [str(tree / name) for name in _SOURCES]
    own = {
        "PYTHONPATH": os.pathsep.join([*paths, str(tree)]),
        "P2O_CACHE": str(folder / "cache"),
        "P2O_STRICT": "1",
        "OMP_NUM_THREADS": "1",
        # A fault of the same length in the same second would be hidden by the compiled file.
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    return {**os.environ, **own}


class Tree:
    """A copy of a tree in which tests run with one fault at a time."""

    def __init__(self, source: Path, folder: Path) -> None:
        self.root, self.folder = copied(source, folder / "tree"), folder

    def tests(self, files: Iterable[str], limit_s: float, without: Iterable[str] = ()) -> tuple[str, list[str]]:
        """Run tests up to the first failure; return "passed", "failed", "hung" or a fault of pytest, and the failures.

        `without` are ids of tests to leave out.
        """
        shutil.rmtree(self.folder / "cache", ignore_errors=True)
        options = ["-q", "-x", "-rfE", "-p", "no:cacheprovider", "-p", "no:randomly", "-m", "not system"]
        left_out = [word for test in without for word in ("--deselect", test)]
        command = [sys.executable, "-m", "pytest", *options, *left_out, *files]
        try:
            done = subprocess.run(
                command, cwd=self.root, env=environment(self.root, self.folder), timeout=limit_s,
                capture_output=True, text=True, errors="replace",
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "hung", []
        failures = _FAILED.findall(done.stdout)
        if done.returncode in (0, 5):
            return "passed", []
        if done.returncode in (1, 2) or (done.returncode < 0 or done.returncode > 5):
            return "failed", failures
        return f"pytest: exit status {done.returncode}: {(done.stderr or done.stdout).strip()[-300:]}", []


class Sound:
    """Tests that fail without any fault, by file; each file is run once in a copy of its own."""

    def __init__(self, tree: Tree) -> None:
        self._tree, self._failing, self._lock = tree, dict[str, list[str]](), threading.Lock()

    def failing(self, test: str) -> list[str]:
        """Return the tests in the file of a test that fail without the fault."""
        file = test.partition("::")[0]
        with self._lock:
            if file not in self._failing:
                failing: list[str] = []
                while (status := self._tree.tests([file], _LIMITS_S[1], failing))[0] == "failed" and status[1]:
                    failing += status[1]
                self._failing[file] = failing if status[0] == "passed" else [*failing, file]
            return self._failing[file]


def tried(mutation: Mutation, tree: Tree, sound: Sound, last_stage: int) -> Outcome:
    """Inject a fault, run the tests, and undo it."""
    near = nearest_tests(tree.root, mutation.path)
    out = Outcome(mutation.name, mutation.kind, mutation.path, stage_1=near)
    others = [file for file in test_files(tree.root) if file not in near]
    file = tree.root / mutation.path
    text = file.read_text(encoding="utf-8")
    began = time.monotonic()
    file.write_text(text.replace(mutation.find, mutation.replace), encoding="utf-8")
    try:
        for stage, files in ((1, near), (2, others)):
            if stage > last_stage or not files:
                continue
            out.stage = stage
            out.outcome, out.test = _judged(tree, sound, files, _LIMITS_S[stage - 1])
            if out.outcome != "survived":
                break
    finally:
        file.write_text(text, encoding="utf-8")
    out.outcome = out.outcome or "survived"
    out.seconds = round(time.monotonic() - began, 1)
    return out


def _judged(tree: Tree, sound: Sound, files: Sequence[str], limit_s: float) -> tuple[str, str]:
    """Return the outcome of one stage, and the first test that fails because of the fault."""
    without: list[str] = []
    while True:
        status, failures = tree.tests(files, limit_s, without)
        if status == "passed":
            return "survived", ""
        if status == "hung":
            return "caught", "(the tests hang)"
        if status != "failed":
            return "void", status
        if not failures:
            return "caught", "(the process ends)"
        also = sound.failing(failures[0])
        if failures[0] not in also and failures[0].partition("::")[0] not in also:
            return "caught", failures[0]
        if failures[0] in without:
            return "void", f"{failures[0]} fails without the fault, too"
        without += also


def report(outcomes: Sequence[Outcome]) -> str:
    """Return the outcomes as a table, and the share of caught faults."""
    lines = [(o.name, o.kind, o.outcome, o.stage, f"{o.seconds:.1f}", o.test) for o in outcomes]
    counts = Counter(o.outcome for o in outcomes)
    share = 100 * counts["caught"] / max(1, len(outcomes) - counts["void"])
    summary = f"{counts['caught']} of {len(outcomes)} faults are caught, {counts['survived']} survive"
    head = ("fault", "kind", "outcome", "stage", "s", "test")
    return f"{table(head, lines)}\n\n{summary}, {counts['void']} are void: {share:.1f} %"


def main(argv: Sequence[str] | None = None) -> int:
    """Try the faults and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--tree", type=Path, default=Path(__file__).parents[1], help="The source tree (default: this).")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="Names of faults.")
    parser.add_argument("--jobs", type=int, default=1, help="Number of copies of the tree that work at a time.")
    parser.add_argument("--stage", type=int, choices=(1, 2), default=2, help="The last stage to run.")
    parser.add_argument("--check", action="store_true", help="Only check that every text is there once.")
    parser.add_argument("--out", type=Path, metavar="FILE.jsonl", help="Append the outcomes to this file.")
    options = parser.parse_args(argv)
    tree = options.tree.resolve()
    unknown = set(options.only or ()) - {mutation.name for mutation in MUTATIONS}
    if unknown:
        parser.error(f"unknown faults: {', '.join(sorted(unknown))}")
    chosen = [mutation for mutation in MUTATIONS if not options.only or mutation.name in options.only]
    reasons = [reason for mutation in chosen if (reason := mutation.mismatch(tree))]
    for reason in reasons:
        print(reason, file=sys.stderr)
    if reasons or options.check:
        print(f"{len(chosen) - len(reasons)} of {len(chosen)} faults fit {tree}")
        return 2 if reasons else 0
    with tempfile.TemporaryDirectory(prefix="p2o-mutations-") as folder:
        copies = [Tree(tree, Path(folder) / str(number)) for number in range(options.jobs + 1)]
        sound, outcomes = Sound(copies.pop()), list[Outcome]()

        def one(mutation: Mutation) -> None:
            copy = copies.pop()
            try:
                outcome = tried(mutation, copy, sound, options.stage)
            finally:
                copies.append(copy)
            print(f"{outcome.name}: {outcome.outcome}, {outcome.seconds:.0f} s  {outcome.test}", flush=True)
            outcomes.append(outcome)
            if options.out is not None:
                add_row(options.out, asdict(outcome))

        with ThreadPoolExecutor(options.jobs) as pool:
            list(pool.map(one, chosen))
    print(report(outcomes))
    return 0


if __name__ == "__main__":
    sys.exit(main())
