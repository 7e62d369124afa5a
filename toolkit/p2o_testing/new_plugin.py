"""A new package with one method of a chosen slot: what `p2o plugin new` writes."""

from __future__ import annotations

import importlib.util
import keyword
import os
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path

from p2o.errors import InputError
from p2o.files.input_file import existing_folder
from p2o.files.whole_file import write_errors
from p2o.host.method import Kind
from p2o.host.registry import Registry

TEMPLATE = Path(__file__).parent / "plugin_template"
"""The files of the package as text: @NAME@ and other words between two @ are filled in."""

_LONGEST = 60
_SCENE = ' --data "synthetic:?right=false&megapixels=0.2"'
_TRIES = {
    Kind.IMAGE_EXTRACTOR: "p2o run --plugin {file} --extractor {name}/rings --matcher nearest" + _SCENE,
    Kind.CLOUD_EXTRACTOR: "p2o run --plugin {file} --extractor canny/{name} --matcher nearest" + _SCENE,
    Kind.MATCHER: "p2o run --plugin {file} --matcher {name} --solver coordinate" + _SCENE,
    Kind.SOLVER: "p2o run --plugin {file} --solver {name}" + _SCENE,
    Kind.INITIALIZER: "p2o run --plugin {file} --init {name}" + _SCENE,
    Kind.CALIBRATOR: "p2o run --plugin {file} --calibrator {name}" + _SCENE,
    Kind.ACCUMULATOR: "p2o run --plugin {file} --accumulate {name} --frames 0" + _SCENE[:-1] + '&frames_per_scene=2"',
    Kind.DATASET: "p2o data check {name}:FOLDER --plugin {file}",
    Kind.EXPORTER: "p2o run --plugin {file} --export {name}:pose.csv" + _SCENE,
    Kind.CALIBRATION_READER: "p2o convert pose.csv pose.yaml --plugin {file} --to text",
}
"""How a method of each kind is tried from its file, before it is installed: on a scene that is quickly rendered."""


@dataclass(frozen=True)
class NewPlugin:
    """The package to write: `name` is that of its distribution and of its method, a slug (a-z, 0-9, -).

    Raises InputError for a name that is no slug, or whose module could not be imported beside what is installed.
    """

    name: str
    kind: Kind

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9]*(-[a-z0-9]+)*", self.name) or len(self.name) > _LONGEST:
            expected = f"a-z, 0-9 and single -, a letter first, at most {_LONGEST} characters, such as acme-edges"
            raise InputError("this is no name for a plugin", where="NAME", expected=expected, got=self.name)
        if keyword.iskeyword(self.module):
            raise InputError("Python keeps this word for itself", where="NAME", got=self.name, hint=self._longer)
        if importlib.util.find_spec(self.module) is not None:
            text = f"a module {self.module} is installed already"
            raise InputError(text, where="NAME", got=self.name, hint=self._longer)

    @property
    def module(self) -> str:
        """The name that Python imports it by."""
        return self.name.replace("-", "_")

    @property
    def file(self) -> str:
        """The file that holds the method, from the root of the package."""
        return f"src/{self.module}/plugin.py"

    @property
    def tried(self) -> str:
        """The command that tries the method from its file."""
        return _TRIES[self.kind].format(file=self.file, name=self.name)

    @property
    def _longer(self) -> str:
        return f"choose a longer name, such as {self.name}-p2o"

    def check_free(self, registry: Registry) -> None:
        """Raise InputError where a method of this kind and name is there already."""
        for offer in registry.of_kind(self.kind):
            if offer.name == self.name:
                text, owner = f"there is a {self.kind.value} of this name already", f"{self.name} of {offer.dist}"
                raise InputError(text, where="NAME", got=owner, hint=self._longer)

    def files(self) -> dict[str, str]:
        """Return the text of every file of the package by its path from the root."""
        sources = {
            "pyproject.toml": "pyproject.toml",
            "README.md": "README.md",
            "LICENSE": "LICENSE",
            ".gitignore": "gitignore",
            ".github/workflows/check.yml": "workflow.yml",
            # A data set needs files to be checked, which its test writes.
            "tests/test_conformance.py": "dataset-test.py" if self.kind is Kind.DATASET else "conformance.py",
        }
        files = {path: self._filled(source) for path, source in sources.items()}
        files[f"src/{self.module}/__init__.py"] = f'"""{self._about} for p2o."""\n'
        files[self.file] = self._filled(f"slots/{self.kind.value.replace(' ', '-')}.py") + self._filled("hook.py")
        return files

    def write(self, parent: Path) -> Path:
        """Write the package into a new folder of its name in `parent`, as a whole or not at all, and return it.

        Raises InputError where the parent is missing, the folder exists, or nothing can be written.
        """
        parent = existing_folder(parent, "--out")
        root = parent / self.name
        if os.path.lexists(root):
            raise InputError("this folder is there already", where=root, hint="choose another name or another --out")
        with write_errors("the package", parent):
            folder = Path(tempfile.mkdtemp(prefix=f".{self.name}-", dir=parent))
        try:
            with write_errors("the package", root):
                # Unlike a folder of mkdtemp, one of mkdir has the usual permissions.
                part = folder / self.name
                for path, text in self.files().items():
                    (part / path).parent.mkdir(parents=True, exist_ok=True)
                    (part / path).write_text(text, encoding="utf-8")
                part.rename(root)
        finally:
            shutil.rmtree(folder, ignore_errors=True)
        return root

    @property
    def _about(self) -> str:
        return f"{'An' if self.kind.value[0] in 'aeiou' else 'A'} {self.kind.value}"

    def _filled(self, source: str) -> str:
        words = {"NAME": self.name, "MODULE": self.module, "HOOK": self.kind.hook, "ABOUT": self._about}
        words["TRY"] = f"    {self.tried}"
        text = (TEMPLATE / f"{source}.txt").read_text(encoding="utf-8")
        return re.sub(r"@([A-Z]+)@", lambda match: words[match[1]], text)
