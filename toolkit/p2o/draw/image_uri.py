"""Images as data URIs, which pages embed."""

from __future__ import annotations

import base64

from p2o.arrays import UInt8

WIDEST_PX = 1400
_QUALITY = 78


def jpeg_uri(image: UInt8) -> str:
    """Return an image (H, W, 3) as a data URI of JPEG, its longer side at most `WIDEST_PX`."""
    import cv2

    height, width = image.shape[:2]
    longest = max(height, width)
    if longest > WIDEST_PX:
        size = (max(1, round(width * WIDEST_PX / longest)), max(1, round(height * WIDEST_PX / longest)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return _data_uri("jpeg", data)


def webp_uri(image: UInt8) -> str:
    """Return an image (H, W, 3) of at most 16383 px per side as a data URI of WebP, at its full size."""
    import cv2

    _, data = cv2.imencode(".webp", image[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])
    return _data_uri("webp", data)


def _data_uri(kind: str, data: UInt8) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data.tobytes()).decode()}"
