"""Images as data URIs, which pages embed."""

from __future__ import annotations

import base64

from p2o.arrays import UInt8

WIDEST_PX = 1400
_QUALITY = 78


def jpeg_uri(image: UInt8, widest_px: int = WIDEST_PX) -> str:
    """Return an image (H, W, 3) as a data URI of JPEG, its longer side at most `widest_px`, up to 65535."""
    import cv2

    height, width = image.shape[:2]
    longest = max(height, width)
    if longest > widest_px:
        size = (max(1, round(width * widest_px / longest)), max(1, round(height * widest_px / longest)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}"
