"""What `p2o pick` knows while someone picks: frames, their pictures, and the pairs, in a file after every change."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from p2o.errors import InputError
from p2o.files.input_file import expanded
from p2o.frames.frame import Dataset, Frame
from p2o.geometry import se3
from p2o.geometry.camera import Camera
from p2o.picks.pairs import Pairs, as_values, pairs_of, read_pairs, write_pairs
from p2o.picks.range_image import LAYERS, Layer, RangeImage, range_image, sector_of
from p2o.picks.solve import PickedFrame, solve_picks


@dataclass(frozen=True, eq=False)
class _Shown:
    frame: Frame
    ranges: RangeImage
    pictures: dict[str, bytes] = field(default_factory=dict)


class Session:
    """Pairs of some frames of a dataset, kept in one file; any number of threads may ask.

    Pairs of other frames that the file holds stay in it. Raises InputError where the file holds something else, or
    its folder is missing.
    """

    def __init__(self, dataset: Sequence[Frame] | Dataset, names: Sequence[str], indices: Sequence[int], path: Path):
        self.names = tuple(names)
        self.path = expanded(path)
        self._dataset, self._indices = dataset, tuple(indices)
        self._lock = threading.RLock()
        if not self.path.parent.is_dir():
            raise InputError("the folder of the pairs is missing", where=self.path.parent, expected="a folder")
        self.frames: dict[str, Pairs] = read_pairs(self.path) if self.path.exists() else {}
        self._shown = lru_cache(maxsize=3)(self._read)
        self._cameras: dict[int, Camera] = {}

    def pairs(self, number: int) -> Pairs:
        """Return the pairs of a frame."""
        return self.frames.get(self.names[number], Pairs.none())

    @property
    def count(self) -> int:
        """How many pairs all frames of the session have."""
        return sum(len(self.pairs(number)) for number in range(len(self.names)))

    def overview(self) -> dict[str, Any]:
        """Return what the page begins with: names of frames, how many pairs each has, and the file."""
        counts = [len(self.pairs(number)) for number in range(len(self.names))]
        return {"frames": list(self.names), "counts": counts, "layers": LAYERS, "path": str(self.path)}

    def described(self, number: int) -> dict[str, Any]:
        """Return sizes and pairs of a frame; raises InputError where it cannot be read."""
        with self._lock:
            shown = self._shown(number)
            height, width = shown.ranges.index.shape
            camera = shown.frame.camera
            return {
                "name": self.names[number],
                "width": camera.width,
                "height": camera.height,
                "columns": width,
                "rows": height,
                "stretch": shown.ranges.stretch,
                "pairs": [self._placed(shown, pair) for pair in as_values(self.pairs(number))],
            }

    def picture(self, number: int, layer: str) -> bytes:
        """Return the PNG of the image ("image") or of a layer of the range image; KeyError for an unknown layer."""
        with self._lock:
            shown = self._shown(number)
            if layer not in shown.pictures:
                if layer != "image" and layer not in LAYERS:
                    raise KeyError(layer)
                rgb = shown.frame.image.rgb if layer == "image" else shown.ranges.drawn(_layer(layer))
                shown.pictures[layer] = _png(rgb)
            return shown.pictures[layer]

    def point(self, number: int, column: float, row: float) -> dict[str, Any] | None:
        """Return the point nearest to a place of the range image, with its pixel; None where none is near."""
        with self._lock:
            shown = self._shown(number)
            found = shown.ranges.nearest(column, row)
            if found is None:
                return None
            xyz = shown.ranges.xyz[shown.ranges.index[found[1], found[0]]]
            return {"xyz": [round(float(x), 6) for x in xyz], "column": found[0], "row": found[1]}

    def keep(self, number: int, values: object) -> int:
        """Take these pairs as those of a frame, write the file and return how many there are.

        Raises InputError for values that are no pairs, a pixel outside of the image, or a file that cannot be written;
        the pairs are what they were then.
        """
        pairs = pairs_of(values, self.names[number])
        with self._lock:
            camera = self._camera(number)
            if not camera.in_image(pairs.uv).all():
                raise InputError("a pixel lies outside of the image", where=self.names[number])
            frames = {**self.frames, self.names[number]: pairs}
            write_pairs(self.path, {name: each for name, each in frames.items() if len(each)})
            self.frames = frames
            return len(pairs)

    def solve(self) -> dict[str, Any]:
        """Return what the pairs of all frames of the session give together: pose, and by frame how far each is off."""
        with self._lock:
            frames = [
                PickedFrame(name, self._camera(number), self.pairs(number))
                for number, name in enumerate(self.names)
                if len(self.pairs(number))
            ]
        solved = solve_picks(frames)
        pose, by_frame = solved.camera_from_lidar, {}
        for at, frame in enumerate(frames):
            mine = solved.frame_of == at
            seen = None if pose is None else frame.camera.project(se3.apply(pose, frame.pairs.xyz))
            by_frame[frame.name] = {
                "off_px": _plain(solved.off_px[mine]),
                "agrees": solved.agrees[mine].tolist(),
                "seen": None if seen is None else [_plain(uv) for uv in seen],
            }
        accuracy = solved.accuracy
        return {
            "status": solved.status.value,
            "solved": pose is not None,
            "reason": solved.reason,
            "pose": None if pose is None else np.round(pose, 9).tolist(),
            "accuracy": None if accuracy is None else [accuracy.rotation_deg, accuracy.translation_m],
            "ambiguous": solved.rival is not None,
            "frames": by_frame,
        }

    def _camera(self, number: int) -> Camera:
        """Return the camera of a frame, which is read once: frames are more than are kept."""
        if number not in self._cameras:
            self._cameras[number] = self._shown(number).frame.camera
        return self._cameras[number]

    def _read(self, number: int) -> _Shown:
        frame = self._dataset[self._indices[number]]
        return _Shown(frame.without_truth(), range_image(frame.cloud, sector_of(frame)))

    def _placed(self, shown: _Shown, pair: Mapping[str, Any]) -> dict[str, Any]:
        """Return a pair with the pixel of its point in the range image, null where it is not in it."""
        index, xyz = shown.ranges.index, shown.ranges.xyz
        nearest = int(np.argmin(np.linalg.norm(xyz - np.array(pair["xyz"]), axis=1)))
        rows, columns = np.nonzero(index == nearest)
        pixel = [int(columns[0]), int(rows[0])] if len(rows) else None
        return {**pair, "pixel": pixel}


def _layer(word: str) -> Layer:
    return next(layer for layer in LAYERS if layer == word)


def _png(rgb: Any) -> bytes:
    import cv2

    _, data = cv2.imencode(".png", np.ascontiguousarray(rgb[..., ::-1]))
    return bytes(data)


def _plain(values: Any) -> list[float | None]:
    return [round(float(value), 3) if np.isfinite(value) else None for value in values]
