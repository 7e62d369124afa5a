"""The built-in frame: a simulated street as files, in the layout of `folder`, which a run without data calibrates."""

from __future__ import annotations

from pathlib import Path

from p2o import Dataset, Method, Options

FOLDER = Path(__file__).with_name("example_frame") / "street"


def build(options: Options) -> Dataset:
    """Return the frame `street`: image, sweep, initial guess and ground truth."""
    from p2o_datasets import folder

    return folder.build(folder.FolderOptions(root=FOLDER))


METHOD = Method(
    name="example",
    build=build,
    summary="The built-in frame, which needs no files of yours: a simulated street as files, with its ground truth.",
    gives=frozenset({"truth", "rings", "intensity", "time"}),
)
