"""The cost that most methods share: points of the sweep lie in the plane that the picture gives."""

from __future__ import annotations

import numpy as np
from p2o import se3
from p2o.arrays import Float

from p2o_baselines.boards.adjustment import Block
from p2o_baselines.boards.pairing import Pair


def off_plane(pair: Pair, pose: Float, weight: float = 1.0) -> Block:
    """Return the distances of all points of a board from its plane in m, times a weight."""
    xyz, normal = se3.apply(pose, pair.patch.xyz), pair.board.normal
    rays = (pair.patch.xyz / np.linalg.norm(pair.patch.xyz, axis=1)[:, None]) @ pose[:3, :3].T
    by_update = np.concatenate([np.cross(xyz, normal), np.broadcast_to(normal, xyz.shape)], axis=1)
    return Block(
        weight * (xyz @ normal - pair.board.offset_m),
        weight * by_update,
        weight * (rays @ normal),
        np.eye(len(xyz)) * (weight * pair.patch.sigma_m) ** 2,
    )


def joined(*blocks: Block) -> Block:
    """Return blocks of one board as one; their noise is independent."""
    from scipy.linalg import block_diag

    return Block(
        np.concatenate([block.residuals for block in blocks]),
        np.concatenate([block.by_update for block in blocks]),
        np.concatenate([block.by_bias for block in blocks]),
        block_diag(*(block.covariance for block in blocks)),
    )
