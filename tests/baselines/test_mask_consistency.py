"""Masks against normals, reflectance and segments: the scores at their extremes, and files of masks."""

import numpy as np
import pytest
from p2o.errors import InputError
from p2o_baselines.segments import masks
from p2o_baselines.segments.cloud_segments import clusters_of, normals_of, planes_of
from p2o_baselines.segments.mask_consistency import cells_of, scores_of
from p2o_baselines.segments.masks import bordered, masks_of, read_masks
from p2o_testing import stage


def scored(normal, strength, segment):
    """Return the scores of one mask that holds all of these points."""
    cell, alike = cells_of(np.asarray(normal, float))
    strength = np.asarray(strength, float)
    counted = np.bincount(cell, minlength=len(alike))[None].astype(float)
    return scores_of(
        counted, alike, strength.sum(keepdims=True), (strength**2).sum(keepdims=True), np.asarray([segment], float)
    )


def test_scores_of_a_mask_are_those_of_its_pairs_of_points():
    alike = scored([[0, 0, 1], [0, 0, -1], [0, 0, 1]], [0.4, 0.4, 0.4], [3])
    assert (alike.normal[0], alike.strength[0], alike.segment[0]) == pytest.approx((1.0, 1.0, 1.0))
    # Of four pairs (a, b) of normals two are parallel and two are at right angles.
    assert scored([[1, 0, 0], [0, 1, 0]], [0, 0], [2]).normal[0] == pytest.approx(0.5)
    assert scored([[0, 0, 1]] * 4, [0, 0, 1, 1], [4]).strength[0] == pytest.approx(0.5)
    # Three, two and one points of three segments: (3 + 2 / 2 + 1 / 4) / 6.
    assert scored([[0, 0, 1]] * 6, [0] * 6, [1, 3, 2]).segment[0] == pytest.approx(4.25 / 6)
    assert scored([[0, 0, 1]], [0.5], [0]).segment[0] == 0


def test_cells_stand_for_all_pairs_of_normals():
    normal = np.random.default_rng(0).normal(size=(400, 3)) * [1, 0.2, 0.2]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    exact = np.abs(normal @ normal.T).mean()
    assert scored(normal, np.zeros(400), [400]).normal[0] == pytest.approx(exact, abs=0.02)


def test_a_large_mask_counts_along_its_border_only():
    shape = np.zeros((300, 400), bool)
    shape[20:280, 20:380] = True
    band = bordered(shape)
    assert not band[150, 200]
    assert band[20, 20]
    assert not (band & ~shape).any()
    small = np.zeros((300, 400), bool)
    small[20:40, 20:60] = True
    assert np.array_equal(bordered(small), small)


def test_a_pixel_knows_every_mask_that_covers_it_and_only_the_largest_count():
    small, large = np.zeros((100, 100), bool), np.zeros((100, 100), bool)
    small[10:14, 10:14], large[8:20, 8:20] = True, True
    found = masks_of([large, small], (100, 100), 10, 1)
    assert sorted(found.labels[12, 12, :2].tolist()) == [0, 1]
    assert found.labels[18, 18].tolist() == [1, -1, -1, -1]
    assert found.area_px.tolist() == [16, 144]
    assert masks_of([large, small], (100, 100), 1, 1).area_px.tolist() == [144]
    assert masks_of([large, small], (100, 100), 10, 20).area_px.tolist() == [144]


@pytest.fixture
def cv2():
    return pytest.importorskip("cv2")


def test_label_images_and_folders_of_one_image_a_mask_are_read_and_others_refused(tmp_path, cv2):
    labels = np.zeros((4, 6), np.uint16)
    labels[0], labels[1] = 7, 300
    cv2.imwrite(str(tmp_path / "a_b.png"), labels)
    assert [mask.any(axis=1).nonzero()[0].tolist() for mask in read_masks(str(tmp_path), "a/b", (4, 6))] == [[0], [1]]
    (tmp_path / "a").mkdir()
    for row in (0, 2):
        cv2.imwrite(str(tmp_path / "a" / f"{row}.png"), np.uint8(255 * (np.arange(4) == row))[:, None].repeat(6, 1))
    assert [mask.any(axis=1).nonzero()[0].tolist() for mask in read_masks(str(tmp_path), "a", (4, 6))] == [[0], [2]]
    for name, size, reason in (("a/b", (8, 6), "another size"), ("c", (4, 6), "no masks of this frame")):
        with pytest.raises(InputError, match=reason):
            read_masks(str(tmp_path), name, size)


def test_masks_of_the_original_image_fit_a_downsampled_one(tmp_path, cv2):
    mask = np.zeros((1200, 1920), np.uint8)
    mask[600:, 480:960] = 255
    (tmp_path / "frame").mkdir()
    cv2.imwrite(str(tmp_path / "frame/0.png"), mask)
    [read] = read_masks(str(tmp_path), "frame", (557, 891))
    assert read.shape == (557, 891)
    assert np.mean(read) == pytest.approx(np.mean(mask > 0), abs=2e-3)
    assert read[400, 300]
    assert not read[100, 300]


def test_the_floor_and_walls_of_a_room_are_its_planes():
    rng = np.random.default_rng(1)
    floor = np.column_stack([rng.uniform(0, 20, (3000, 2)), np.zeros(3000)])
    wall = np.column_stack([np.full(2000, 20.0), rng.uniform(0, 20, 2000), rng.uniform(0.5, 6, 2000)])
    xyz = np.concatenate([floor, wall])
    normal = np.concatenate([np.tile([0, 0, 1.0], (3000, 1)), np.tile([1.0, 0, 0], (2000, 1))])
    found = planes_of(xyz, normal, np.random.default_rng(0), least=1000, band_m=0.2, normal_weight=0.2)
    assert (found[:3000] == 0).all()
    assert (found[3000:] == 1).all()


def test_clusters_are_what_small_steps_lead_between():
    line = np.column_stack([np.arange(10) * 0.2, np.zeros(10), np.zeros(10)])
    xyz = np.concatenate([line, line + [0, 5, 0], [[50, 0, 0]]])
    assert clusters_of(xyz, 0.25, 5, 100).tolist() == [0] * 10 + [1] * 10 + [-1]
    assert (clusters_of(xyz, 0.25, 5, 9) == -1).all()


def test_normals_of_a_tilted_plane_face_the_sensor():
    rng = np.random.default_rng(0)
    across, along = rng.uniform(-3, 3, (2, 500))
    xyz = np.column_stack([10 + across, along, across])
    expected = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2)
    assert np.allclose(normals_of(xyz, 20), expected, atol=1e-6)


def test_superpixels_are_further_masks():
    image = stage.frame().image
    found = [
        len(masks.build(masks.MasksOptions(superpixels=kind))(image).get("image-masks"))
        for kind in ("none", "slic", "seeds")
    ]
    assert 0 < found[0] < min(found[1:])
