"""Weights of regressors: safetensors in half precision, whose header says which method, size and stages they are of."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import p2o
import torch
from p2o import InputError, MethodUnavailable
from p2o.files.input_file import expanded, read_bytes
from p2o.files.parsed_text import parse_json
from p2o.files.whole_file import write_whole
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from p2o_baselines.regressors.decalibration import Reach
from p2o_baselines.regressors.design import Design
from p2o_baselines.regressors.parts import PairNetwork

FOLDER = Path(__file__).parents[1] / "weights"
_KIND = "p2o-regressor"
_MOST_BYTES = 2 << 30


@dataclass(frozen=True)
class Trained:
    """What a weights file says of itself: method, size of the network, stages, and free text by key."""

    method: str
    size: str
    stages: tuple[Reach, ...]
    about: Mapping[str, str] = field(default_factory=dict)


def write_weights(network: PairNetwork, trained: Trained, path: Path) -> None:
    """Write the weights in half precision, whole or not at all."""
    state = {n: v.half() if v.is_floating_point() else v for n, v in network.state_dict().items()}
    about = {"method": trained.method, "size": trained.size, "stages": trained.stages, "about": dict(trained.about)}
    write_tensors(path, state, {"kind": _KIND, "network": json.dumps(about, sort_keys=True)})


def write_tensors(path: Path, tensors: Mapping[str, Tensor], header: Mapping[str, str]) -> None:
    """Write a safetensors file whole or not at all; the same content gives the same bytes."""
    plain = {name: value.detach().cpu().contiguous() for name, value in tensors.items()}
    raw = save(plain, metadata=dict(header))
    size = int.from_bytes(raw[:8], "little")
    entries = json.loads(raw[8 : 8 + size])
    entries["__metadata__"] = dict(sorted(entries["__metadata__"].items()))
    text = json.dumps(entries, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 8)
    write_whole(path, len(text).to_bytes(8, "little") + text + raw[8 + size :])


def read_tensors(path: Path, what: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Return the tensors and the header of a safetensors file; raises InputError where it is none."""
    raw = read_bytes(path, what, _MOST_BYTES)
    try:
        size = int.from_bytes(raw[:8], "little")
        if not 0 < size <= min(len(raw) - 8, 100 << 20):
            raise ValueError("its header is cut off")
        header = parse_json(raw[8 : 8 + size].rstrip(b" "), what, path).get("__metadata__", {})
        return load(raw), {str(k): str(v) for k, v in header.items()}
    except (SafetensorError, ValueError, AttributeError, KeyError, RuntimeError) as problem:
        raise InputError(f"a {what} cannot be read", where=path, expected="safetensors", got=problem) from problem


def read_weights(path: Path, design: Design) -> tuple[PairNetwork, Trained]:
    """Return the network of a weights file, ready to predict, and what the file says of itself.

    Raises InputError for a file that is missing or damaged, and for weights of another method.
    """
    state, header = read_tensors(path, "file of weights")
    trained = _trained(header, path)
    if trained.method != design.name:
        raise InputError(
            "the weights are those of another method",
            where=path,
            expected=f"weights of {design.name}, by p2o train {design.name}",
            got=f"weights of {trained.method}",
            hint=f"--calibrator {trained.method}",
        )
    if trained.size not in design.pictures:
        raise _foreign(path, design.name, f"a size of {design.name}", trained.size)
    # Compared before memory is taken for what a header may have made up.
    with torch.device("meta"):
        wanted = {name: tuple(value.shape) for name, value in design.network(trained.size).state_dict().items()}
    found = {name: tuple(value.shape) for name, value in state.items()}
    wrong = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
    if wrong:
        raise _foreign(path, design.name, f"{wrong[0]} {wanted.get(wrong[0], 'absent')}", found.get(wrong[0], "none"))
    network = design.network(trained.size)
    network.load_state_dict({n: v.float() if v.is_floating_point() else v for n, v in state.items()})
    if any(not bool(torch.isfinite(value).all()) for value in network.state_dict().values()):
        raise InputError("weights are not finite", where=path, expected="numbers", got="NaN or infinity")
    return network.eval(), trained


def weights_files(said: str, design: Design) -> list[Path]:
    """Return the files that the option `weights` names; raises where a method comes without."""
    if said in design.pictures:
        path = FOLDER / f"{design.name}-{said}.safetensors"
        if not path.is_file():
            raise MethodUnavailable(
                f"{design.name} comes without weights of size {said}",
                where="weights",
                expected="a file that p2o train wrote",
                hint=f"p2o train {design.name} --data ... --out DIR, then weights=DIR/weights.safetensors",
            )
        return [path]
    return [expanded(part.strip()) for part in said.split(",") if part.strip()] or [Path(said)]


def branch_tensors(path: Path, network: PairNetwork) -> dict[str, Tensor]:
    """Return the tensors of both branches in any regressor's weights that fit a network; raises where none does."""
    state, header = read_tensors(path, "file of weights")
    _trained(header, path)
    own = network.state_dict()
    fitting = {
        name: value.float() if value.is_floating_point() else value
        for name, value in state.items()
        if name.startswith(("picture.", "sweep.", "trunk.")) and name in own and own[name].shape == value.shape
    }
    if not fitting:
        raise InputError("no branch fits", where=path, expected="weights with branches alike", got="none that fit")
    return fitting


def _trained(header: Mapping[str, str], path: Path) -> Trained:
    try:
        if header["kind"] != _KIND:
            raise ValueError(header["kind"])
        said = parse_json(header["network"], "header of weights", path)
        stages = tuple((float(deg), float(metres)) for deg, metres in said["stages"])
        if not stages or not all(0 < d <= 90 and 0 < m <= 10 for d, m in stages):
            raise ValueError(f"stages {stages}")
        about = {str(k): str(v) for k, v in dict(said["about"]).items()}
        return Trained(str(said["method"]), str(said["size"]), stages, about)
    except (KeyError, ValueError, TypeError) as problem:
        raise _foreign(path, "a regressor", "a file that p2o train wrote", problem) from problem


def _foreign(path: Path, whose: str, expected: str, got: object) -> InputError:
    return InputError(f"no weights of {whose}", where=path, expected=expected, got=str(got)[:120])


def stages_of(networks: Sequence[tuple[PairNetwork, Trained]]) -> list[tuple[PairNetwork, Trained, Reach]]:
    """Return every stage of all networks, in the order of the files."""
    return [(network, trained, reach) for network, trained in networks for reach in trained.stages]


def device_of(name: str) -> torch.device:
    """Return the device of an option; raises InputError for a GPU that is not there."""
    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    if name != "cpu" and int(name.partition(":")[2] or 0) >= torch.cuda.device_count():
        raise p2o.InputError(
            "there is no such GPU",
            where="device",
            expected=f"cpu, or one of {torch.cuda.device_count()} GPUs",
            got=name,
        )
    return torch.device(name)
