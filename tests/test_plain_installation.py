"""What `pip install p2o-calib` brings: a list of packages, and which of them take more than 20 MB."""

from __future__ import annotations

import tomllib
from pathlib import Path

from packaging.requirements import Requirement

from tests.test_third_party import closure

PROJECT = tomllib.loads(Path(__file__).parents[1].joinpath("pyproject.toml").read_text(encoding="utf-8"))["project"]
LARGE = {"numpy", "scipy", "opencv-contrib-python-headless", "onnxruntime", "pillow", "embreex"}
"""Packages of more than 20 MB on Linux: 520 MB in all, of at most 650 MB."""
SMALL = {
    "click", "jinja2", "joblib", "ml-dtypes", "packaging", "platformdirs", "pluggy", "pydantic", "pyyaml", "rich",
    "safetensors", "simplejpeg", "threadpoolctl",
}  # fmt: skip
OF_EXTRAS = {"torch", "kornia", "onnx", "pycolmap", "matplotlib", "fonttools", "pyarrow", "laspy", "rosbags"}


def names(requirements: list[str]) -> set[str]:
    return {Requirement(text).name.replace("_", "-") for text in requirements}


def test_a_plain_installation_has_these_packages() -> None:
    """A new one needs a reason, and an extra if a calibration with the default methods does not need it."""
    assert names(PROJECT["dependencies"]) == LARGE | SMALL


def test_nothing_that_it_requires_brings_a_package_of_an_extra() -> None:
    assert not closure(frozenset()) & OF_EXTRAS
