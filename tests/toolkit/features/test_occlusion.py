"""The occlusion rule labels what hides something and nothing else (METHODS: numeric cases of docs/conventions.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from p2o import Camera, InputError, Side
from p2o.features.occlusion import Orders, edges_from_orders, mirrored, occlusion_orders, side_maps, without_short

INF = np.inf
ROW = Camera.pinhole(100, 100, 2.5, 0, 6, 1)


def halves(left: tuple[float, float], right: tuple[float, float]) -> tuple[tuple[float, float], ...]:
    return (left,) * 3 + (right,) * 3


@dataclass(frozen=True)
class Case:
    """One image row: depths in metres, expected orders, inverse-depth lines (at 0, slope) of surfaces that slant."""

    name: str
    z: tuple[float, ...]
    step_only: tuple[int, ...]
    full: tuple[int, ...]
    full_25mm: tuple[int, ...] | None = None
    slanted: tuple[tuple[float, float], ...] = ()

    @property
    def lines(self) -> np.ndarray:
        return np.array(self.slanted or [(1 / z, 0.0) for z in self.z]).T


NONE = (0, 0, 0, 0, 0)
ALL = (1, 1, 1, 1, 1)
CREASE, CROSSING = ((0.0625, -0.005), (0.0525, -0.001)), ((0.1, 0.0), (1 / 11.4 + 3 * 0.01324, -0.01324))
STEP = ((0.10, -0.004), (0.06, -0.004))
CASES = [
    Case("A step", (10, 10, 10, 5, 5, 5), (0, 0, -1, 0, 0), (0, 0, -1, 0, 0)),
    Case("B slanted plane", (20, 22.222, 25, 28.571, 33.333, 40), ALL, NONE, slanted=((0.05, -0.005),) * 6),
    Case("C crease half-way", (16, 17.391, 19.048, 20.202, 20.619, 21.053), ALL, NONE, slanted=halves(*CREASE)),
    Case("D planes cross", (10, 10, 10, 11.4, 13.427, 16.330), (0, 0, 1, 1, 1), NONE, slanted=halves(*CROSSING)),
    Case("E one-pixel pole", (20, 20, 20, 8, 30, 30), (0, 0, -1, 1, 0), (0, 0, -1, 1, 0)),
    Case("F object against sky", (INF, INF, 30, 30, INF, INF), (0, -1, 0, 1, 0), (0, -1, 0, 1, 0)),
    Case("G small step", (10, 10, 10, 10.3, 10.3, 10.3), NONE, NONE, full_25mm=(0, 0, 1, 0, 0)),
    Case("H slanted step", (10, 10.417, 10.870, 20.833, 22.727, 25), ALL, (0, 0, 1, 0, 0), slanted=halves(*STEP)),
]
each_case = pytest.mark.parametrize("case", CASES, ids=lambda c: c.name)


def normals(case: Case) -> np.ndarray:
    """True normals: 1/z = a + b u is (a + 2.5 b) + 100 b x on the plane z = 1."""
    a, b = case.lines
    return np.stack([100 * b, 0 * b, a + 2.5 * b + 1e-300], axis=-1)[None]


def east(case: Case, z: np.ndarray | None = None, **options: object) -> tuple[int, ...]:
    orders = occlusion_orders(np.array([case.z]) if z is None else z, ROW, **options)
    return tuple(orders.east[0, :5].tolist())


@each_case
def test_the_step_alone_and_the_full_rule_with_estimated_planes(case: Case) -> None:
    assert east(case, planes=False) == case.step_only
    assert east(case) == case.full
    assert east(case, min_jump_m=0.025) == (case.full_25mm or case.full), "at 25 mm only the small step appears"


@each_case
def test_the_full_rule_with_true_normals_whose_sign_and_length_do_not_matter(case: Case) -> None:
    assert east(case, normals=normals(case)) == case.full
    assert east(case, normals=-7 * normals(case)) == case.full
    a, b = case.lines
    with np.errstate(divide="ignore"):
        exact = 1 / (a + b * np.arange(6))[None]  # the table's rounding is worth millimetres at condition 3
    np.testing.assert_allclose([case.z], exact, rtol=5e-5)  # five figures in the table
    assert east(case, exact, min_jump_m=0.025, normals=normals(case)) == (case.full_25mm or case.full)


@each_case
def test_the_edge_points_are_the_foreground_pixels_and_a_column_is_labelled_like_a_row(case: Case) -> None:
    uv, side = edges_from_orders(occlusion_orders(np.array([case.z]), ROW))
    foreground = [(at, "R") if order > 0 else (at + 1, "L") for at, order in enumerate(case.full) if order]
    assert sorted((int(u), Side(int(s)).letter) for (u, _), s in zip(uv, side, strict=True)) == sorted(foreground)
    orders = occlusion_orders(np.array([case.z]).T, Camera.pinhole(100, 100, 0, 2.5, 1, 6))
    assert tuple(orders.south[:5, 0].tolist()) == case.full
    assert not orders.east.any()


BOX = np.full((7, 8), 10.0)
BOX[2:5, 3:5] = 5.0
BOX_CAMERA = Camera.pinhole(100, 100, 3.5, 3, 8, 7)


def test_a_box_has_its_four_sides_where_they_belong() -> None:
    found = side_maps(occlusion_orders(BOX, BOX_CAMERA))
    for side, rows, columns in (
        (Side.LEFT, slice(2, 5), 3),
        (Side.RIGHT, slice(2, 5), 4),
        (Side.UPPER, 2, slice(3, 5)),
        (Side.BOTTOM, 4, slice(3, 5)),
    ):
        only = np.zeros((7, 8), bool)
        only[rows, columns] = True
        np.testing.assert_array_equal(found[side], only)


def test_diagonal_pairs_of_a_box_follow_its_depth() -> None:
    orders = occlusion_orders(BOX, BOX_CAMERA, connectivity=8)
    np.testing.assert_array_equal(orders.south_east[:-1, :-1], np.sign(BOX[1:, 1:] - BOX[:-1, :-1]))
    np.testing.assert_array_equal(orders.north_east[1:, :-1], np.sign(BOX[:-1, 1:] - BOX[1:, :-1]))
    outside = (orders.south_east[-1], orders.south_east[:, -1], orders.north_east[0], orders.north_east[:, -1])
    assert not any(order.any() for order in outside)
    # The threshold is longer by the root of two.
    step = np.where(np.arange(8) < 4, 10.0, 10.5) * np.ones((8, 1))
    orders = occlusion_orders(step, Camera.pinhole(1000, 1000, 3.5, 3.5, 8, 8), connectivity=8)
    assert (orders.east[:, 3] == 1).all()
    assert not orders.south_east.any()  # 0.5 / 1.414 < 0.4


def road(quantised: bool = False) -> tuple[np.ndarray, Camera]:
    """A flat road 1.65 m below the camera, from 8 rows below the horizon on."""
    camera = Camera.pinhole(725.0087, 725.0087, 10, -8, 21, 181)
    z = 1.65 * 725.0087 / (np.arange(181) + 8.0)[:, None] * np.ones(21)
    return (np.round(z, 2) if quantised else z), camera


@pytest.mark.parametrize("quantised", [False, True])
def test_a_flat_road_has_no_edge(quantised: bool) -> None:
    uv, _ = edges_from_orders(occlusion_orders(*road(quantised)))
    assert len(uv) == 0


def test_without_planes_a_flat_road_beyond_22_m_is_all_edges() -> None:
    z, camera = road()
    orders = occlusion_orders(z, camera, planes=False)
    far = z[1:, 10] > np.sqrt(0.4 * 725.0087 * 1.65)  # z^2 / (f h) metres from row to row
    upper = orders.south[:-1, 10] == -1
    assert abs(int(upper.sum()) - int(far.sum())) <= 1
    assert upper.sum() > 40


@pytest.mark.parametrize("known_normals", [False, True])
def test_a_road_that_reaches_the_horizon_has_no_edge_against_the_sky(known_normals: bool) -> None:
    camera = Camera.pinhole(725, 725, 10, 19.4, 21, 60)
    below = (np.arange(60) - 19.4)[:, None] * np.ones(21)
    with np.errstate(divide="ignore"):
        z = np.where(below > 0, 1.65 * 725 / np.maximum(below, 0), INF)
    upwards = np.broadcast_to([0.0, -1.0, 0.0], (*z.shape, 3)) if known_normals else None
    assert len(edges_from_orders(occlusion_orders(z, camera, normals=upwards))[0]) == 0


CAMERAS = {
    "PINHOLE": Camera.pinhole(60, 65, 50, 38, 101, 75),
    "OPENCV": Camera("OPENCV", 101, 75, (60, 65, 50, 38, -0.2, 0.04, 0.001, -0.002)),
    "OPENCV_FISHEYE": Camera("OPENCV_FISHEYE", 101, 75, (50, 51, 50, 38, 0.02, -0.006, 0.001, -0.0002)),
}


def plane_depth(camera: Camera, normal: tuple[float, float, float], offset_m: float) -> np.ndarray:
    """Depth of the plane normal . X = offset_m seen by every pixel; sky where the plane is not met."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([u, v], axis=-1).astype(float))
    with np.errstate(divide="ignore"):
        distance = offset_m / (rays @ np.array(normal))
    return np.where(distance > 0, distance * rays[..., 2], INF)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
@pytest.mark.parametrize("normal", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.02), (0.7, 0.0, 0.4), (-0.6, 0.5, 0.5)])
def test_a_plane_has_no_edge_in_any_camera(camera: Camera, normal: tuple[float, float, float]) -> None:
    z = plane_depth(camera, normal, 6.0)
    z[z > 80] = INF
    orders = occlusion_orders(z, camera)
    ends = np.isinf(z)
    inside = ~(ends[:, :-1] | ends[:, 1:])
    assert not orders.east[:, :-1][inside].any()
    assert not orders.south[:-1][~(ends[:-1] | ends[1:])].any()


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_board_in_front_of_a_slanted_plane_has_exactly_its_outline(camera: Camera) -> None:
    z = plane_depth(camera, (0.1, 0.1, 1.0), 20.0)
    assert np.isfinite(z).all()
    z[20:50, 30:70] = 4.0
    board = z == 4.0
    found = side_maps(occlusion_orders(z, camera))
    expected = np.zeros_like(found)
    expected[Side.LEFT, :, 1:] = board[:, 1:] & ~board[:, :-1]
    expected[Side.RIGHT, :, :-1] = board[:, :-1] & ~board[:, 1:]
    expected[Side.UPPER, 1:] = board[1:] & ~board[:-1]
    expected[Side.BOTTOM, :-1] = board[:-1] & ~board[1:]
    np.testing.assert_array_equal(found, expected)


def test_the_step_is_one_of_distance_not_of_depth_and_a_relative_one_grows_with_distance() -> None:
    """A wall at right angles to the axis, far off the axis: depths are equal, distances are not."""
    z = np.full((1, 6), 100.0)
    camera = Camera.pinhole(100, 100, -300, 0, 6, 1)
    assert (occlusion_orders(z, camera, planes=False).east[0, :5] == 1).all()
    assert not occlusion_orders(z, camera).east.any()
    camera = Camera.pinhole(1000, 1000, 2.5, 0, 6, 1)
    near, far = np.array([[10.0] * 3 + [11.0] * 3]), np.array([[50.0] * 3 + [51.0] * 3])
    for z, labels in ((near, 1), (far, 0)):
        assert occlusion_orders(z, camera, relative_jump=0.05).east[0, 2] == labels
        assert occlusion_orders(z, camera).east[0, 2] == 1


def made_up_scene(seed: int, camera: Camera = CAMERAS["PINHOLE"]) -> np.ndarray:
    """A slanted ground with sky above, and boards of all depths."""
    rng = np.random.default_rng(seed)
    z = plane_depth(camera, (0.05, 1.0, 0.1), 1.7)
    z[z > 200] = INF
    for _ in range(25):
        u, v = rng.integers(0, camera.width), rng.integers(0, camera.height)
        width, height = rng.integers(1, 30, 2)
        z[v : v + height, u : u + width] = rng.uniform(2, 60)
    return z


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize("seed", range(3))
def test_flipping_the_scene_is_mirroring_the_orders(seed: int, connectivity: int) -> None:
    camera = CAMERAS["PINHOLE"]
    flipped_camera = Camera.pinhole(60, 65, camera.width - 1 - 50, 38, 101, 75)
    z = made_up_scene(seed)
    before = z.copy()
    orders = occlusion_orders(z, camera, connectivity=connectivity)
    np.testing.assert_array_equal(z, before)
    flipped = occlusion_orders(z[:, ::-1], flipped_camera, connectivity=connectivity)
    assert orders.east.any()
    for name, order in flipped.present.items():
        np.testing.assert_array_equal(order, getattr(mirrored(orders), name), err_msg=name)
    for name, order in mirrored(mirrored(orders)).present.items():
        np.testing.assert_array_equal(order, getattr(orders, name), err_msg=name)
    there, back = side_maps(orders), side_maps(mirrored(orders))
    for side in (Side.LEFT, Side.RIGHT, Side.UPPER, Side.BOTTOM):
        np.testing.assert_array_equal(back[side.mirrored], there[side][:, ::-1])


def test_turning_the_scene_by_a_transpose_exchanges_rows_and_columns() -> None:
    z = made_up_scene(1)
    orders = occlusion_orders(z, CAMERAS["PINHOLE"], connectivity=8)
    turned = occlusion_orders(z.T, Camera.pinhole(65, 60, 38, 50, 75, 101), connectivity=8)
    np.testing.assert_array_equal(turned.south, orders.east.T)
    np.testing.assert_array_equal(turned.east, orders.south.T)
    np.testing.assert_array_equal(turned.south_east, orders.south_east.T)


@pytest.mark.parametrize("seed", range(3))
def test_forgetting_pixels_takes_labels_away_and_adds_none(seed: int) -> None:
    z = made_up_scene(seed)
    whole = occlusion_orders(z, CAMERAS["PINHOLE"])
    lost = np.random.default_rng(seed).random(z.shape) < 0.1
    holey = occlusion_orders(np.where(lost, np.nan, z), CAMERAS["PINHOLE"])
    for name in ("east", "south"):
        kept = getattr(holey, name)
        assert 0 < np.count_nonzero(kept) < np.count_nonzero(getattr(whole, name))
        np.testing.assert_array_equal(kept[kept != 0], getattr(whole, name)[kept != 0])
    assert not holey.east[lost].any()
    assert not holey.south[lost].any()


def test_sky_is_never_in_front_and_needs_no_neighbour_to_be_known_as_flat() -> None:
    """At the image border and beside unknown pixels a surface cannot be told; sky can."""
    scene = made_up_scene(2)
    maps = side_maps(occlusion_orders(scene, CAMERAS["PINHOLE"], planes=False)).any(axis=0)
    assert np.isinf(scene).any()
    assert not maps[np.isinf(scene)].any()
    z = np.array([[INF, 30, 30, 30, INF, np.nan]])
    assert occlusion_orders(z, ROW).east[0, :5].tolist() == [-1, 0, 0, 1, 0]
    assert not occlusion_orders(np.where(np.isinf(z), 60.0, z), ROW).east.any()


def test_a_plane_that_a_ray_leaves_behind_is_infinitely_far() -> None:
    """Pixel 2 lies on 1/z = 0.1 - 0.3 (u - 2): gone before pixel 3, so what is seen there need not be hidden by it."""
    z = np.array([[10.0, 10, 10, 30, 30, 30]])
    facing = np.broadcast_to([0.0, 0.0, 1.0], (1, 6, 3)).copy()
    assert occlusion_orders(z, ROW, normals=facing).east[0, 2] == 1
    facing[0, 2] = (-30.0, 0.0, 0.7 - 2.5 * 0.3)
    assert occlusion_orders(z, ROW, normals=facing).east[0, 2] == 0


def test_edges_of_masked_foreground_go_and_edges_in_front_of_it_stay() -> None:
    """A pole (6 m) stands before a tree (12 m) before a wall (20 m)."""
    z = np.array([[20.0, 20, 12, 12, 6, 6, 12, 12, 20, 20]])
    camera = Camera.pinhole(100, 100, 4.5, 0, 10, 1)
    assert np.flatnonzero(occlusion_orders(z, camera).east).tolist() == [1, 3, 5, 7]
    assert np.flatnonzero(occlusion_orders(z, camera, masked=z == 12).east).tolist() == [3, 5]


@pytest.mark.parametrize("connectivity", [4, 8])
@pytest.mark.parametrize("spike_m", [5.0, 20.0])
def test_a_lone_pixel_is_noise_two_together_are_not(spike_m: float, connectivity: int) -> None:
    camera = Camera.pinhole(100, 100, 4, 4, 9, 9)
    z = np.full((9, 9), 10.0)
    z[4, 4] = spike_m
    orders = occlusion_orders(z, camera, connectivity=connectivity)
    assert not any(order.any() for order in orders.present.values())
    z[4, 5] = spike_m
    orders = occlusion_orders(z, camera, connectivity=connectivity)
    assert all(order.any() for order in orders.present.values())


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (2, 2)])
def test_the_smallest_images_have_no_edges(shape: tuple[int, int]) -> None:
    camera = Camera.pinhole(10, 10, 0, 0, shape[1], shape[0])
    orders = occlusion_orders(np.full(shape, 3.0), camera, connectivity=8)
    assert len(edges_from_orders(orders)[0]) == 0


def test_pieces_are_counted_side_by_side_and_over_corners() -> None:
    maps = np.zeros((4, 12, 12), bool)
    diagonal = np.arange(5)
    maps[0, diagonal, diagonal] = True  # five, connected over corners
    maps[1, 0, :4] = True  # four, though ...
    maps[2, 0, 4:6] = True  # ... two of another side continue them
    kept = without_short(maps, 5)
    assert kept[0].sum() == 5
    assert not kept[1:].any()
    np.testing.assert_array_equal(without_short(maps, 1), maps)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"min_jump_m": 0.0}, "jump"),
        ({"min_jump_m": np.nan}, "jump"),
        ({"connectivity": 6}, "connectivity"),
        ({"normals": np.zeros((7, 8))}, "normals"),
        ({"masked": np.zeros((8, 7), bool)}, "masked"),
        ({"depth_m": BOX.T}, "depth_m has the wrong shape"),
        ({"depth_m": np.where(BOX == 5, 0.0, BOX)}, "not positive"),
    ],
)
def test_wrong_depths_and_options_are_refused(options: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        occlusion_orders(**{"depth_m": BOX, "camera": BOX_CAMERA, **options})


def test_orders_refuse_other_shapes_other_values_and_half_a_diagonal() -> None:
    zero = np.zeros((3, 4), np.int8)
    for maps, text in (
        ((zero, zero.T), "wrong shape"),
        ((zero, zero + 2), "other values"),
        ((zero, zero, zero), "diagonal"),
        ((zero[0], zero[0]), "not a map"),
    ):
        with pytest.raises(InputError, match=text):
            Orders(*maps)
