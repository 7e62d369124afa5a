"""Features are kept in files that may be damaged, forged or foreign, and hashes tell content apart."""

from __future__ import annotations

import importlib
import io
import json
import re
import sys
import tracemalloc
import zipfile
from collections import namedtuple
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import p2o
import pytest
from p2o import Camera, CloudEdges, CloudFeatures, Image, ImageEdges, ImageFeatures, InputError
from p2o.cache import FeatureCache, cache_folder, content_hash

FEATURES = ImageFeatures(ImageEdges(np.array([[1 / 3, 2.0], [3, 4]]), np.array([0, -1]), np.array([0.1, 0.2])))
IMAGE = Image(np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3), Camera.pinhole(5, 5, 3, 2, 6, 4))


def test_features_and_arrays_come_back_with_every_bit_and_can_be_written_to(tmp_path: Path) -> None:
    cache = FeatureCache(tmp_path)
    cloud = CloudFeatures(CloudEdges(np.array([[1, 2, 1 / 7]]), np.array([2])), np.zeros((0, 3)))
    for key, features in (("aa1", FEATURES), ("bb2", cloud), ("cc3", ImageFeatures())):
        assert cache.get(key) is None
        assert cache.put(key, features, 0.25)
        kept = cache.get(key)
        assert kept.seconds == 0.25
        assert type(kept.features) is type(features)
        assert content_hash(kept.features) == content_hash(features)
    values = [np.asfortranarray(np.arange(6.0).reshape(2, 3)), np.array(7), np.zeros((0, 3)), np.arange(3, dtype=">i4")]
    cache.put("dd4", values, 0.0)
    for mine, theirs in zip(values, cache.get("dd4").features, strict=True):
        assert mine.tobytes("A") == theirs.tobytes("A")
        assert (mine.dtype, mine.shape) == (theirs.dtype, theirs.shape)
        assert mine.flags.f_contiguous == theirs.flags.f_contiguous
        theirs[...] = 1


def test_numbers_of_single_precision_take_half_the_space(tmp_path: Path) -> None:
    cache, single = FeatureCache(tmp_path), np.arange(10_000, dtype=np.float64) / 8
    cache.put("a" * 64, (single,), 0.0)
    cache.put("b" * 64, (single + 1e-9,), 0.0)
    sizes = [cache.path(key * 64).stat().st_size for key in "ab"]
    assert sizes[0] < 0.6 * sizes[1]
    for key, array in (("a", single), ("b", single + 1e-9)):
        (kept,) = cache.get(key * 64).features
        assert kept.dtype == np.float64
        np.testing.assert_array_equal(kept, array)


def _npz(**members: bytes) -> bytes:
    """Return a file of the cache with these entries."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as content:
        for name, data in members.items():
            content.writestr(f"{name}.npy", data)
    return file.getvalue()


def _npy(value: object = 0, shape: str = "", dtype: str = "") -> bytes:
    """Return an .npy file, with another shape or type in its head than it has."""
    file = io.BytesIO()
    np.save(file, np.asarray(value))
    magic, head, body = file.getvalue()[:10], file.getvalue()[10:128].decode(), file.getvalue()[128:]
    head = re.sub(r"'shape': \(.*?\)", f"'shape': {shape}", head) if shape else head
    head = re.sub(r"'descr': '.*?'", f"'descr': {dtype}", head) if dtype else head
    return magic + head.strip().ljust(117).encode() + b"\n" + body


def _head(features: object, seconds: object = 0.0) -> bytes:
    text = features if isinstance(features, str) else json.dumps({"features": features, "seconds": seconds})
    return _npy(np.frombuffer(text.encode(), np.uint8))


ARRAY = {"array": "array0"}
PLAIN = _head(ARRAY)
FORGED = {
    "terabytes": _npz(head=PLAIN, array0=_npy([1.0], shape="(1000000000000,)")),
    "terabytes in two axes": _npz(head=PLAIN, array0=_npy([1.0], shape="(1000000, 1000000)")),
    "a negative shape": _npz(head=PLAIN, array0=_npy([1.0], shape="(-1,)")),
    "a shape that is code": _npz(head=PLAIN, array0=_npy([1.0], shape="(__import__('os').getpid(),)")),
    "objects": _npz(head=PLAIN, array0=_npy([1.0], dtype="'|O'")),
    "a type with parts": _npz(head=PLAIN, array0=_npy([1.0], dtype="[('a', '<f8')]")),
    "types of no size": _npz(head=PLAIN, array0=_npy([1.0], shape="(1000000000000,)", dtype="'|V0'")),
    "a deep head": _npz(head=_head('{"features": ' + "[" * 100_000)),
    "no seconds": _npz(head=_head({"value": 1}, None)),
    "seconds without end": _npz(head=_head({"value": 1}, float("inf"))),
    "a head that is no text": _npz(head=_npy(np.frombuffer(b"\xff\xfe", np.uint8))),
    "an array that is missing": _npz(head=PLAIN),
    "no head": _npz(array0=_npy([1.0])),
    "edges of a wrong shape": _npz(
        head=_head({"kind": ["p2o.features.edges", "ImageEdges"], "parts": {"uv": ARRAY, "side": ARRAY}}),
        array0=_npy([[1.0, 2.0, 3.0]]),
    ),
}


def _growing() -> bytes:
    """Return a small file whose entries grow when they are read."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as content:
        content.writestr("head.npy", PLAIN)
        content.writestr("array0.npy", _npy(np.zeros(10_000_000)))
    return file.getvalue()


@pytest.mark.parametrize("case", [*FORGED, "growing", "half", "nothing", "one byte"])
def test_a_forged_or_damaged_file_counts_as_none_takes_no_memory_and_is_replaced(tmp_path: Path, case: str) -> None:
    cache = FeatureCache(tmp_path)
    cache.put("aa", FEATURES, 0.0)
    data = cache.path("aa").read_bytes()
    damaged = {"half": data[: len(data) // 2], "nothing": b"", "one byte": data[:300] + b"x" + data[301:]}
    content = _growing() if case == "growing" else {**FORGED, **damaged}[case]
    assert len(content) < 200_000
    cache.path("aa").write_bytes(content)
    tracemalloc.start()
    try:
        assert cache.get("aa") is None
        assert tracemalloc.get_traced_memory()[1] < (2 if case == "growing" else 30) * 2**20
    finally:
        tracemalloc.stop()
    cache.put("aa", FEATURES, 0.0)
    assert cache.get("aa") is not None


def test_what_the_method_may_not_return_counts_as_none(tmp_path: Path) -> None:
    """A whole and valid file, put under the key of another method."""
    cache = FeatureCache(tmp_path)
    registry = p2o.Registry.load(environ={})
    [canny] = registry.named("canny")
    [rings] = registry.named("rings")
    edges = {"aa": FEATURES, "bb": CloudFeatures(CloudEdges(np.ones((1, 3)), np.zeros(1, int)), np.zeros((0, 3)))}
    for key, features in {**edges, "cc": {"a": 1}, "dd": None, "ee": ImageFeatures()}.items():
        cache.put(key, features, 0.0)
        assert cache.get(key) is not None
    assert [key for key in ("aa", "bb", "cc", "dd", "ee") if cache.get(key, canny)] == ["aa"]
    assert [key for key in ("aa", "bb", "cc", "dd", "ee") if cache.get(key, rings)] == ["bb"]


def test_nothing_is_left_of_a_file_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(InputError, match=r"No space left.*P2O_CACHE"):
        FeatureCache(tmp_path).put("aa", FEATURES, 0.0)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


def test_hashes_tell_images_shapes_types_and_borders_apart() -> None:
    hashes = {content_hash(IMAGE)}
    assert content_hash(Image(IMAGE.rgb.copy(), IMAGE.camera)) in hashes
    changed = IMAGE.rgb.copy()
    changed[3, 5, 2] ^= 1
    others = [
        Image(changed, IMAGE.camera),
        Image(IMAGE.rgb, Camera.pinhole(5, 5, 3, 2.000001, 6, 4)),
        Image(IMAGE.rgb, IMAGE.camera, depth_m=np.ones((4, 6))),
        Image(IMAGE.rgb, IMAGE.camera, right=IMAGE.rgb, baseline_m=0.5),
    ]
    hashes |= {content_hash(image) for image in others}
    assert len(hashes) == 5
    values = [["ab", "c"], ["a", "bc"], ["abc"], 1, 1.0, True, "1", None, {"a": 1}, [["a", 1]], np.zeros((2, 3))]
    values += [np.zeros((3, 2)), np.zeros((2, 3), np.float32), [0.0] * 6]
    assert len({content_hash(value) for value in values}) == len(values)
    assert content_hash({"a": 1, "b": 2}) == content_hash({"b": 2, "a": 1})


def test_the_folder_is_the_users_cache_unless_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/z")
    monkeypatch.setenv("P2O_CACHE", "~/y")
    assert cache_folder() == Path.home() / "y"
    monkeypatch.setenv("P2O_CACHE", "")
    if sys.platform == "linux":
        assert cache_folder() == Path("/z/p2o")
    monkeypatch.delenv("XDG_CACHE_HOME")
    home = {"linux": ".cache/p2o", "darwin": "Library/Caches/p2o", "win32": "AppData/Local/p2o/Cache"}
    assert cache_folder() == Path.home() / home[sys.platform]


CORNERS = "from dataclasses import dataclass\n@dataclass(frozen=True)\nclass Corners:\n    edges: object\n"


def _named(cache: FeatureCache, module: str, name: str) -> None:
    """Write a file whose features are of a type that somebody else names."""
    cache.put("aa", FEATURES, 0.0)
    with np.load(cache.path("aa")) as content:
        arrays = {key: content[key] for key in content.files}
    head = json.loads(arrays["head"].tobytes())
    head["features"]["kind"] = [module, name]
    np.savez(cache.path("aa"), **{**arrays, "head": np.frombuffer(json.dumps(head).encode(), np.uint8)})


@pytest.mark.parametrize(
    ("module", "name"),
    [
        ("os", "system"),
        ("subprocess", "Popen"),
        ("p2o.features.edges", "replace"),
        ("p2o.cache", "FeatureCache.__init__"),
        ("joblib.parallel", "BatchedCalls"),
    ],
)
def test_a_file_that_names_what_is_no_dataclass_of_ours_counts_as_none(tmp_path: Path, module: str, name: str) -> None:
    cache = FeatureCache(tmp_path)
    _named(cache, module, name)
    assert cache.get("aa") is None
    _named(cache, "p2o.features.sets", "ImageFeatures")
    assert cache.get("aa") is not None


@pytest.mark.parametrize("package", ["acme_never_loaded", "p2o_plugin_file_never_loaded"])
def test_no_module_that_a_file_names_is_imported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    """The module is there and has the type; it is not taken because nobody else has imported it."""
    (tmp_path / f"{package}.py").write_text(CORNERS)
    monkeypatch.syspath_prepend(tmp_path)
    cache = FeatureCache(tmp_path)
    _named(cache, package, "Corners")
    assert cache.get("aa") is None
    assert package not in sys.modules


def test_types_of_a_plugin_are_kept_while_it_is_loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "p2o_plugin_file_corners.py").write_text(CORNERS)
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("p2o_plugin_file_corners")
    cache = FeatureCache(tmp_path)
    assert cache.put("aa", module.Corners(np.eye(2)), 0.0)
    assert type(cache.get("aa").features) is module.Corners
    del sys.modules[module.__name__]
    assert cache.get("aa") is None


@dataclass(frozen=True)
class Foreign:
    """A dataclass of no plugin."""

    uv: np.ndarray


def test_what_has_no_form_or_would_not_be_found_again_is_not_kept(tmp_path: Path) -> None:
    endless: list[object] = []
    endless.append(endless)

    @dataclass(frozen=True)
    class Local:
        uv: np.ndarray

    cache = FeatureCache(tmp_path)
    formless = (object(), {"edges": np.array([object()])}, endless, {1: np.eye(2)}, namedtuple("Pair", "a b")(1, 2))
    for features in (Foreign(np.eye(2)), Local(np.eye(2)), *formless):
        assert not cache.put("aa", features, 0.0)
    assert not cache.has("aa")
