"""Linear systems of unknowns shared by all frames and of two unknowns per frame, solved by the Schur complement."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from p2o.arrays import Float


@dataclass(frozen=True, eq=False)
class BlockCovariance:
    """The covariance of a solution: `shared` (Q, Q) of the shared unknowns, `own` (F, 2, 2) of those of each frame.

    Each of G independent right sides moves the shared unknowns by a column of `by_shared` (Q, G), and the unknowns of
    the frames by a row of `by_own` (G, 2 F), sparse, minus `eliminated` (2 F, Q) times that column.
    """

    shared: Float
    own: Float
    by_shared: Float
    by_own: Any
    eliminated: Float

    def through(self, matrix: Float) -> Float:
        """Return the covariance (N, N) of a product of a matrix (N, 2 F) with the unknowns of the frames."""
        rows = np.asarray(self.by_own @ matrix.T).T - (matrix @ self.eliminated) @ self.by_shared
        return np.asarray(rows @ rows.T)


@dataclass(frozen=True, eq=False)
class BlockSystem:
    """A symmetric matrix: `shared` (Q, Q) of the unknowns of all frames, `mixed` (F, Q, 2), `own` (F, 2, 2) of each."""

    shared: Float
    mixed: Float
    own: Float

    @cached_property
    def _eliminated(self) -> Float:
        """Minus the derivatives (F, 2, Q) of the unknowns of each frame by the shared ones, once solved."""
        return np.asarray(np.linalg.solve(self.own, self.mixed.transpose(0, 2, 1)))

    @cached_property
    def _schur(self) -> Float:
        return np.asarray(self.shared - np.tensordot(self.mixed, self._eliminated, axes=([0, 2], [0, 1])))

    def solve(self, shared: Float, own: Float) -> tuple[Float, Float]:
        """Return the solution (Q,) and (F, 2) for right sides of these shapes; the smallest of several."""
        reduced = shared - np.tensordot(self._eliminated, own, axes=([0, 1], [0, 1]))
        solution = np.asarray(np.linalg.lstsq(self._schur, reduced, rcond=None)[0], np.float64)
        return solution, np.linalg.solve(self.own, own[..., None])[..., 0] - self._eliminated @ solution

    def without(self, frame: int, shared: Float, mixed: Float, own: Float) -> BlockSystem:
        """Return the system less the share (Q, Q), (Q, 2), (2, 2) of one frame."""
        columns, blocks = self.mixed.copy(), self.own.copy()
        if len(blocks):
            columns[frame] -= mixed
            blocks[frame] -= own
        return replace(self, shared=self.shared - shared, mixed=columns, own=blocks)

    def covariance(self, shared: Float, own: Any) -> BlockCovariance:
        """Return the covariance of the solution for independent right sides: rows (G, Q), and sparse ones (G, 2 F)."""
        from scipy import sparse

        frames, following = len(self.own), self._eliminated.reshape(-1, len(self.shared))
        by_shared = np.linalg.pinv(self._schur) @ (shared - np.asarray(own @ following)).T
        of_shared = by_shared @ by_shared.T
        if not frames:
            return BlockCovariance(of_shared, np.zeros((0, 2, 2)), by_shared, own, following)
        inverses = sparse.block_diag(list(np.linalg.inv(self.own)), format="csr")
        by_own = sparse.csr_array(own @ inverses)
        columns = [by_own[:, [*range(axis, 2 * frames, 2)]] for axis in (0, 1)]
        squares = np.array([[a.multiply(b).sum(axis=0) for b in columns] for a in columns]).reshape(2, 2, frames)
        cross = np.asarray(by_own.T @ by_shared.T).reshape(frames, 2, -1) @ self._eliminated.transpose(0, 2, 1)
        follows = self._eliminated @ of_shared @ self._eliminated.transpose(0, 2, 1)
        blocks = squares.transpose(2, 0, 1) - cross - cross.transpose(0, 2, 1) + follows
        return BlockCovariance(of_shared, blocks, by_shared, by_own, following)
