"""One HTML file with everything in it: a template, its parts, and a policy that lets nothing else be loaded."""

from __future__ import annotations

import base64
import hashlib
import importlib.resources
from collections.abc import Mapping, Sequence

from p2o.arrays import UInt8

WIDEST_PX = 1400
_QUALITY = 78


def part(name: str) -> str:
    """Return a file that lies beside this module."""
    return importlib.resources.files("p2o.report").joinpath(name).read_text(encoding="utf-8")


def filled(template: str, parts: Mapping[str, str], scripts: Sequence[str]) -> str:
    """Return the page of a template with its places {{name}} filled; only `scripts` may run, and nothing may be loaded.

    Head and style that all pages share are put around it; parts have a `title`, and a `style` of their own.
    """
    policy = "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    policy += "script-src " + " ".join(map(_source_hash, scripts))
    # The places are found in the template alone: none of the parts is searched.
    head, *rest = part("shell.html").replace("{{body}}", part(template)).split("{{")
    found = {"policy": policy, **parts, "style": part("shell.css") + parts["style"]}
    return head + "".join(found[name] + text for name, text in (piece.split("}}", 1) for piece in rest))


def jpeg_uri(picture: UInt8, quality: int = _QUALITY) -> str:
    """Return a picture (H, W, 3) as a data URI of JPEG, its longer side at most `WIDEST_PX`."""
    import cv2

    height, width = picture.shape[:2]
    longest = max(height, width)
    if longest > WIDEST_PX:
        size = (max(1, round(width * WIDEST_PX / longest)), max(1, round(height * WIDEST_PX / longest)))
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    _, data = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode()


def _source_hash(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
