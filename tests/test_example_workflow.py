"""The workflow that plugin authors copy: its commands pass on the example plugin, and fail when a method gets worse."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.test_example_plugin import SOURCE, Machine

PAGE = Path(__file__).parents[1] / "docs" / "how-to" / "ablation-ci.md"
WORKFLOW = SOURCE / ".github" / "workflows" / "accuracy.yml"
STUDY = SOURCE / "p2o_example" / "studies" / "example-gate.toml"


class Checkout:
    """A fresh copy of the example on a machine of its own, and what a runner does with it."""

    def __init__(self, root: Path) -> None:
        self.folder = shutil.copytree(SOURCE, root / "checkout", ignore=shutil.ignore_patterns("__pycache__"))
        self.machine = Machine(root / "machine")
        scripts = self.machine.python.parent
        # What the wheel of p2o installs, where it is installed as a dependency.
        (scripts / "p2o").write_text(f'#!/bin/sh\nexec "{self.machine.python}" -m p2o "$@"\n')
        (scripts / "p2o").chmod(0o755)
        self.path = f"{scripts}{os.pathsep}{os.environ['PATH']}"

    def steps(self) -> list[subprocess.CompletedProcess[str]]:
        """Run every `run:` of the workflow in order, as far as they pass; the install does without a network."""
        done = []
        [job] = yaml.safe_load((self.folder / WORKFLOW.relative_to(SOURCE)).read_text())["jobs"].values()
        for step in job["steps"]:
            if "run" not in step:
                continue
            if step["run"].startswith("pip install . "):
                words = ["--no-index", "--no-deps", "--no-build-isolation", "--force-reinstall", "."]
                command = f"python -m pip --python {self.machine.python} install {' '.join(words)}"
                path = os.environ["PATH"]
                path = f"{Path(sys.executable).parent}{os.pathsep}{path}"
            else:
                command, path = step["run"], self.path
            environ = {**os.environ, **step.get("env", {}), "PATH": path}
            environ.pop("P2O_PLUGINS", None)
            words = ["bash", "-e", "-o", "pipefail", "-c", command]
            done.append(
                subprocess.run(words, capture_output=True, text=True, check=False, cwd=self.folder, env=environ)
            )
            if done[-1].returncode:
                break
        return done


@pytest.mark.skipif(os.name == "nt", reason="the workflow's commands are for bash")
def test_the_workflow_passes_on_the_example_and_fails_when_a_method_gets_worse(tmp_path: Path) -> None:
    checkout = Checkout(tmp_path)
    install, gate = checkout.steps()
    assert install.returncode == 0, install.stderr
    assert gate.returncode == 0, gate.stdout + gate.stderr
    assert "gate: open" in gate.stdout
    assert list((checkout.folder / "study").glob("*.jsonl")), "what the workflow uploads"

    # Somebody puts all edges two pixels off.
    extractor = checkout.folder / "p2o_example" / "grey_steps.py"
    text = extractor.read_text()
    worse = text.replace("np.column_stack([u, v]).astype(float)", "np.column_stack([u, v]) + 2.0")
    assert worse != text
    extractor.write_text(worse)
    install, gate = checkout.steps()
    assert install.returncode == 0, install.stderr
    assert gate.returncode == 1, gate.stdout + gate.stderr
    assert re.search(r"FAIL  grey-steps: mean rotation_deg", gate.stdout)
    assert "FAIL  gauss-newton" not in gate.stdout


def test_the_page_shows_the_files_of_the_example() -> None:
    page = PAGE.read_text(encoding="utf-8")
    [study] = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    [workflow] = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert STUDY.read_text(encoding="utf-8") == study
    assert WORKFLOW.read_text(encoding="utf-8") == workflow
