"""Self-contained HTML pages: Jinja2 templates, and a content security policy that blocks all requests."""

from __future__ import annotations

import base64
import hashlib
import importlib.resources
import math
from collections.abc import Sequence
from functools import cache
from typing import Any

from markupsafe import Markup, escape

from p2o.arrays import UInt8
from p2o.errors import printable

WIDEST_PX = 1400
_QUALITY = 78
_LONGEST = 5000
"""Maximum number of characters of a text on a page."""


def part(name: str) -> str:
    """Return the text of a file PACKAGE/FILE."""
    package, _, file = name.partition("/")
    return importlib.resources.files(package).joinpath(file).read_text(encoding="utf-8")


def rendered(
    template: str,
    *,
    style: str,
    scripts: Sequence[str] = (),
    script_files: bool = False,
    image_files: bool = False,
    **values: Any,
) -> str:
    """Return the page of a template and a style sheet, PACKAGE/FILE each; only `scripts` may run.

    With `script_files` these may load further scripts from the folder of the page, and from nowhere else; with
    `image_files` the page may load images from there.

    The template extends "p2o.draw/shell.html"; `values` contain the `title` of the page. Texts are escaped, and their
    control characters written out.
    """
    # A file has no origin in all browsers: 'self' is that of a server, file: that of a page that is opened from disk.
    files = ("'self'", "file:")
    images = " ".join(["img-src", "data:", "blob:", *(files if image_files else ())])
    policy = f"default-src 'none'; {images}; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'; "
    policy += " ".join(["script-src", *map(_source_hash, scripts), *(files if script_files else ())])
    css = part("p2o.draw/shell.css") + part(style)
    own = {"policy": Markup(policy), "style": Markup(css), "scripts": [Markup(script) for script in scripts]}
    return _templates().get_template(template).render(values, **own)  # type: ignore[no-any-return]


@cache
def _templates() -> Any:
    import jinja2

    loader = jinja2.FunctionLoader(part)
    # StrictUndefined: a misspelt name in a template raises.
    undefined = jinja2.StrictUndefined
    environment = jinja2.Environment(
        loader=loader, autoescape=True, finalize=_text, undefined=undefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"number": number_text, "lines": _lines}
    return environment


def number_text(value: Any, places: int) -> str:
    """Return a number with these decimals, "-" for other values and numbers that are not finite."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return "-"
    return f"{value:.{places}f}"


def _text(value: Any) -> Any:
    """Return HTML unchanged, other values as text with control characters written out."""
    return value if hasattr(value, "__html__") else printable(value, _LONGEST)


def _lines(text: str) -> Markup:
    """Return a text of several lines as HTML."""
    return Markup("\n").join(escape(_text(line)) for line in text.split("\n"))


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
    # Base64 needs no escapes.
    return Markup(f"data:image/{kind};base64,") + Markup(base64.b64encode(data.tobytes()).decode())


def _source_hash(script: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()}'"
