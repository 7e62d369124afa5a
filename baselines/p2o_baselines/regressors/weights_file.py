"""Weights of regressors: safetensors in half precision, with method, size and stages in the header."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import torch
from p2o import InputError
from p2o.reading import parse_json, read_tensors, write_tensors
from torch import Tensor

from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.parts import PairNetwork
from p2o_baselines.regressors.sample import Reach

_KIND = "p2o-regressor"


@dataclass(frozen=True)
class Trained:
    """The header of a weights file: method, size of the network, stages, and free text by key."""

    method: str
    size: str
    stages: tuple[Reach, ...]
    about: Mapping[str, str] = field(default_factory=dict)


def write_weights(network: PairNetwork, trained: Trained, path: Path) -> None:
    """Write the weights in half precision, atomically."""
    state = {n: (v.half() if v.is_floating_point() else v).cpu().numpy() for n, v in network.state_dict().items()}
    about = {"method": trained.method, "size": trained.size, "stages": trained.stages, "about": dict(trained.about)}
    write_tensors(path, state, {"kind": _KIND, "network": json.dumps(about, sort_keys=True)})


def read_weights(path: Path, design: Design) -> tuple[PairNetwork, Trained]:
    """Return the network of a weights file for inference, and the header. Raises InputError for other files."""
    state, header = read_tensors(path, "file of weights")
    trained = _trained(header, path)
    if trained.method != design.name:
        raise InputError(
            "the weights belong to another method",
            where=path,
            expected=f"weights of {design.name}, by p2o train {design.name}",
            got=f"weights of {trained.method}",
            hint=f"--calibrator {trained.method}",
        )
    if trained.size not in design.inputs:
        raise _foreign(path, design.name, f"a size of {design.name}", trained.size)
    # Compare before memory is allocated for sizes that an invalid header may contain.
    with torch.device("meta"):
        network = design.network(trained.size)
    wanted = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    sizes = {name: tuple(value.shape) for name, value in state.items()}
    wrong = sorted(name for name in wanted.keys() | sizes.keys() if wanted.get(name) != sizes.get(name))
    if wrong:
        raise _foreign(path, design.name, f"{wrong[0]} {wanted.get(wrong[0], 'absent')}", sizes.get(wrong[0], "none"))
    tensors = {n: v.float() if v.is_floating_point() else v for n, v in state.items()}
    network.load_state_dict(tensors, assign=True)
    if any(not bool(torch.isfinite(value).all()) for value in network.state_dict().values()):
        raise InputError("weights are not finite", where=path, expected="numbers", got="NaN or infinity")
    return network.eval(), trained


def branch_tensors(path: Path, network: PairNetwork) -> dict[str, Tensor]:
    """Return the tensors of both branches in the weights of any regressor that fit a network; raises if none fits."""
    state, header = read_tensors(path, "file of weights")
    _trained(header, path)
    own = network.state_dict()
    fitting = {
        name: value.float() if value.is_floating_point() else value
        for name, value in state.items()
        if name.startswith(("picture.", "sweep.", "trunk.")) and name in own and own[name].shape == value.shape
    }
    if not fitting:
        raise InputError("no branch fits", where=path, expected="weights with branches of the same shape", got="none")
    return fitting


def _trained(header: Mapping[str, str], path: Path) -> Trained:
    try:
        if header["kind"] != _KIND:
            raise ValueError(header["kind"])
        fields = parse_json(header["network"], "header of weights", path)
        stages = tuple((float(deg), float(metres)) for deg, metres in fields["stages"])
        if not stages or not all(0 < d <= 90 and 0 < m <= 10 for d, m in stages):
            raise ValueError(f"stages {stages}")
        about = {str(k): str(v) for k, v in dict(fields["about"]).items()}
        return Trained(str(fields["method"]), str(fields["size"]), stages, about)
    except (KeyError, ValueError, TypeError) as problem:
        raise _foreign(path, "a regressor", "a file written by p2o train", problem) from problem


def _foreign(path: Path, whose: str, expected: str, got: object) -> InputError:
    return InputError(f"no weights of {whose}", where=path, expected=expected, got=str(got)[:120])
