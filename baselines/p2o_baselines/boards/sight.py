"""What a frame has to do with boards: those in its picture, and what may be boards in its sweep."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import p2o
from p2o import Checkerboard, HoleBoard

from p2o_baselines.boards.board_in_picture import BoardInPicture, boards_in_picture
from p2o_baselines.boards.board_in_sweep import BoardInSweep, boards_in_sweep
from p2o_baselines.boards.holes_in_picture import hole_boards_in_picture
from p2o_baselines.boards.holes_in_sweep import hole_boards_in_sweep


class BoardOptions(p2o.Options):
    """Options of every method of boards: what is looked at, and how exact the sensors are."""

    farthest_m: float = p2o.field(12.0, gt=0, le=200, help="Boards are looked for so far from the LiDAR.")
    scatter_m: float = p2o.field(0.04, gt=0, le=1, help="Ranges scatter about a board by no more than this.")
    range_bias_m: float = p2o.field(
        0.01, ge=0, le=1, help="Deviation of an error that all ranges share, for the likely error."
    )
    camera_px: float = p2o.field(
        0.5, ge=0, le=100, help="Deviation of the camera's calibration in pixels, for the likely error."
    )
    worst_deg: float = p2o.field(5.0, gt=0, le=180, help="Results less sure than this about some axis are refused.")
    worst_m: float = p2o.field(0.5, gt=0, le=100, help="Results less sure than this along some axis are refused.")


@dataclass(frozen=True)
class Sight:
    """One frame: `asked` says which boards were looked for, `boards` those in the picture, `patches` in the sweep."""

    name: str
    asked: str
    boards: tuple[BoardInPicture, ...]
    patches: tuple[BoardInSweep, ...]


def sight_of(frame: p2o.Frame, options: BoardOptions) -> Sight:
    """Return what a frame shows of its checkerboards; the sweep is searched only where the picture shows one."""
    targets = [target for target in frame.targets if isinstance(target, Checkerboard)]
    asked = ", ".join(
        f"{t.columns} x {t.rows} corners on {t.width_m:g} x {t.height_m:g} m" for t in dict.fromkeys(targets)
    )
    boards = boards_in_picture(frame.image, targets)
    sizes = [(board.target.width_m, board.target.height_m) for board in boards]
    patches = _patches(frame.cloud, tuple(sizes), options) if sizes else ()
    return Sight(frame.name, asked or "none", boards, patches)


def hole_sight_of(frame: p2o.Frame, options: BoardOptions) -> Sight:
    """Return what a frame shows of its boards with holes; the sweep is searched only where the picture shows one."""
    targets = [target for target in frame.targets if isinstance(target, HoleBoard)]
    asked = ", ".join(
        f"{len(t.holes)} holes in {t.width_m:g} x {t.height_m:g} m"
        for t in {(t.width_m, t.height_m, t.holes): t for t in targets}.values()
    )
    boards = hole_boards_in_picture(frame.image, targets)
    kinds = tuple(dict.fromkeys(board.target for board in boards if isinstance(board.target, HoleBoard)))
    patches = _hole_patches(frame.cloud, kinds, options) if kinds else ()
    return Sight(frame.name, asked or "none", boards, patches)


def _hole_patches(cloud: p2o.Cloud, kinds: tuple[HoleBoard, ...], options: BoardOptions) -> tuple[BoardInSweep, ...]:
    found, asked = _known.setdefault(cloud, {}), (kinds, options.farthest_m, options.scatter_m)
    if asked not in found:
        found[asked] = hole_boards_in_sweep(cloud, kinds, farthest_m=options.farthest_m, sigma_m=options.scatter_m)
    return found[asked]


_known: WeakKeyDictionary[p2o.Cloud, dict[Hashable, tuple[BoardInSweep, ...]]] = WeakKeyDictionary()
"""What was found in sweeps that are still in use: the search takes seconds, and all methods of boards ask the same."""


def _patches(
    cloud: p2o.Cloud, sizes_m: tuple[tuple[float, float], ...], options: BoardOptions
) -> tuple[BoardInSweep, ...]:
    found, asked = _known.setdefault(cloud, {}), (sizes_m, options.farthest_m, options.scatter_m)
    if asked not in found:
        found[asked] = boards_in_sweep(cloud, sizes_m, farthest_m=options.farthest_m, sigma_m=options.scatter_m)
    return found[asked]
