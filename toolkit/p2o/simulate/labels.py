"""Exact directed edge labels of a picture: the occlusion rule on exact depth with exact normals."""

from __future__ import annotations

from p2o.features.occlusion import Orders, occlusion_orders
from p2o.geometry.camera import Camera
from p2o.simulate.render import Picture


def labels(
    picture: Picture, camera: Camera, *, mask_foliage: bool = False, min_jump_m: float = 0.4, relative_jump: float = 0.0
) -> Orders:
    """Return which pixels hide which of their neighbours (connectivity 8); edges of leaves are left out on request.

    `p2o.occlusion.edges_from_orders` turns the orders into directed edge pixels.
    """
    return occlusion_orders(
        picture.depth_m,
        camera,
        min_jump_m=min_jump_m,
        relative_jump=relative_jump,
        normals=picture.normals,
        masked=picture.foliage if mask_foliage else None,
        connectivity=8,
    )
