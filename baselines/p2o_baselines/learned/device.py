"""The device on which networks run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from p2o import InputError
from p2o.solving import has_gpu_driver

if TYPE_CHECKING:
    import torch


def device_of(name: str) -> torch.device:
    """Return the device of an option (auto, cpu, cuda:N); raises InputError for a GPU that does not exist."""
    import torch

    if name == "auto":
        return torch.device("cuda" if has_gpu_driver() and torch.cuda.is_available() else "cpu")
    if name != "cpu" and int(name.partition(":")[2] or 0) >= torch.cuda.device_count():
        expected = f"cpu, or one of {torch.cuda.device_count()} GPUs"
        raise InputError("the GPU does not exist", where="device", expected=expected, got=name)
    return torch.device(name)
