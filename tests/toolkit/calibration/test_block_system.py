"""The Schur complement gives what the whole matrix gives."""

from __future__ import annotations

import numpy as np
import pytest
from p2o.calibration.block_system import BlockSystem
from scipy import sparse


def system(shared: int, frames: int) -> tuple[BlockSystem, np.ndarray]:
    """A system with random positive definite blocks, and the same as one matrix."""
    rng = np.random.default_rng(shared + frames)
    root = rng.normal(size=(60, shared + 2 * frames))
    for frame in range(frames):  # each row is of one frame
        others = np.arange(60) % frames != frame
        root[others, shared + 2 * frame : shared + 2 * frame + 2] = 0.0
    whole = root.T @ root + 0.1 * np.eye(shared + 2 * frames)
    pairs = [slice(shared + 2 * frame, shared + 2 * frame + 2) for frame in range(frames)]
    mixed = np.array([whole[:shared, pair] for pair in pairs]).reshape(frames, shared, 2)
    own = np.array([whole[pair, pair] for pair in pairs]).reshape(frames, 2, 2)
    return BlockSystem(whole[:shared, :shared], mixed, own), whole


@pytest.mark.parametrize(("shared", "frames"), [(6, 0), (7, 1), (9, 5)])
def test_solutions_and_covariances_are_those_of_the_whole_matrix(shared: int, frames: int) -> None:
    blocks, whole = system(shared, frames)
    right = np.random.default_rng(1).normal(size=len(whole))
    solution, of_frames = blocks.solve(right[:shared], right[shared:].reshape(-1, 2))
    np.testing.assert_allclose(np.r_[solution, of_frames.ravel()], np.linalg.solve(whole, right), atol=1e-12)
    rows = np.random.default_rng(2).normal(size=(30, len(whole)))
    inverse = np.linalg.inv(whole)
    covariance = inverse @ rows.T @ rows @ inverse
    solved = blocks.covariance(rows[:, :shared], sparse.csr_array(rows[:, shared:]))
    np.testing.assert_allclose(solved.shared, covariance[:shared, :shared], atol=1e-12)
    for frame, block in enumerate(solved.own):
        at = slice(shared + 2 * frame, shared + 2 * frame + 2)
        np.testing.assert_allclose(block, covariance[at, at], atol=1e-12)
    matrix = np.random.default_rng(3).normal(size=(4, 2 * frames))
    np.testing.assert_allclose(solved.through(matrix), matrix @ covariance[shared:, shared:] @ matrix.T, atol=1e-12)


def test_a_frame_that_is_left_out_leaves_the_system_of_the_others() -> None:
    blocks, whole = system(9, 5)
    share = np.zeros_like(whole)
    part = np.random.default_rng(4).normal(size=(3, 11))
    at = np.r_[0:9, 13:15]  # frame 2
    share[np.ix_(at, at)] = 0.01 * part.T @ part
    rest = blocks.without(2, share[:9, :9], share[:9, 13:15], share[13:15, 13:15])
    right = np.random.default_rng(5).normal(size=len(whole))
    solution, of_frames = rest.solve(right[:9], right[9:].reshape(-1, 2))
    np.testing.assert_allclose(np.r_[solution, of_frames.ravel()], np.linalg.solve(whole - share, right), atol=1e-11)
