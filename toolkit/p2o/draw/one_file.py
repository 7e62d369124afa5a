"""Self-contained HTML pages: a template, its parts, and a content security policy that blocks all requests."""

from __future__ import annotations

import base64
import hashlib
import importlib.resources
from collections.abc import Mapping, Sequence

from p2o.arrays import UInt8

WIDEST_PX = 1400
_QUALITY = 78


def part(name: str, package: str = "p2o.draw") -> str:
    """Return the text of a file of a package."""
    return importlib.resources.files(package).joinpath(name).read_text(encoding="utf-8")


def filled(body: str, parts: Mapping[str, str], scripts: Sequence[str]) -> str:
    """Return the page of a body with its placeholders {{name}} replaced; only `scripts` may run.

    The body is embedded in the common head and style; `parts` contains the `title` and the `style` of the page.
    """
    policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    policy += "script-src " + " ".join(map(_source_hash, scripts))
    # Only the template is searched for placeholders, not the parts.
    head, *rest = part("shell.html").replace("{{body}}", body).split("{{")
    values = {"policy": policy, **parts, "style": part("shell.css") + parts["style"]}
    return head + "".join(values[name] + text for name, text in (piece.split("}}", 1) for piece in rest))


def jpeg_uri(image: UInt8) -> str:
    """Return an image (H, W, 3) as a data URI of JPEG, its longer side at most `WIDEST_PX`."""
    import cv2

    height, width = image.shape[:2]
    longest = max(height, width)
    if longest > WIDEST_PX:
        size = (max(1, round(width * WIDEST_PX / longest)), max(1, round(height * WIDEST_PX / longest)))
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def _source_hash(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
