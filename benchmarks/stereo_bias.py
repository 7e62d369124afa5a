"""Where do stereo edges lie? Bias, spread, precision and recall of every direction on pairs with exact truth.

    python benchmarks/stereo_bias.py [--data KITTI_RAW] [--pairs 24] [--seed 1] [--fit] [--set min_confidence=0.3 ...]

The pairs are layered: pieces cut from left images (or from procedural textures without --data) stand before a
background, each on its own disparity plane, and both views are sampled from the same continuous layers, with soft
borders, gain, noise and JPEG as in real pairs. So the place of every silhouette is known to a hundredth of a pixel.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from p2o import SIDES, Camera, Image, ImageEdges, Side
from p2o.arrays import Float, UInt8
from p2o_plugins.image import silhouette, stereo

FITTING_DRIVES = "0009 0014 0015 0017 0018 0028"
CHECKING_DRIVES = "0032 0051 0056 0059"
WIDTH, HEIGHT, HORIZON = 1242, 375, 172.0


@dataclass(frozen=True)
class Layer:
    """A textured shape on a disparity plane: `inside(x, y)` is about the signed distance in px to its outline.

    `plane` (a, b, c): disparity a + b x + c y in px at left pixel (x, y); `texture` (H, W, 3) with its `offset` (2,).
    """

    texture: Float
    offset: tuple[float, float]
    plane: tuple[float, float, float]
    inside: Callable[[Float, Float], Float]

    def disparity(self, x: Float, y: Float) -> Float:
        a, b, c = self.plane
        return a + b * x + c * y


@dataclass(frozen=True)
class Truth:
    """Every silhouette point of a pair: `uv` (N, 2) px, `side` (N,), the fall of the disparity `jump` (N,) px."""

    uv: Float
    side: np.ndarray
    jump: Float


def rectangle(cx: float, cy: float, half_width: float, half_height: float, turn: float = 0.0):
    cos, sin = np.cos(turn), np.sin(turn)

    def inside(x, y):
        right, down = (x - cx) * cos + (y - cy) * sin, (y - cy) * cos - (x - cx) * sin
        return np.minimum(half_width - np.abs(right), half_height - np.abs(down))

    return inside


def blob(cx: float, cy: float, half_width: float, half_height: float, waves: Float, phases: Float):
    """A smooth irregular outline: an ellipse whose radius is modulated by a few harmonics."""
    number = np.arange(2, 2 + len(waves))

    def inside(x, y):
        u, v = (x - cx) / half_width, (y - cy) / half_height
        angle, radius = np.arctan2(v, u), np.hypot(u, v) + 1e-9
        outline = 1 + sum(w * np.cos(n * angle + p) for n, w, p in zip(number, waves, phases, strict=True))
        slope = sum(-n * w * np.sin(n * angle + p) for n, w, p in zip(number, waves, phases, strict=True))
        f_angle, f_radius = slope / radius, -1.0
        f_u = (f_radius * u - f_angle * v) / radius / half_width
        f_v = (f_radius * v + f_angle * u) / radius / half_height
        return (outline - radius) / (np.hypot(f_u, f_v) + 1e-9)

    return inside


def car(rng: np.random.Generator, texture: Float, cx: float, foot: float, d: float):
    """A car from the side or from behind, its paint (H, W, 3) in left pixels and its outline.

    Roof, belt line and bumper run along the outline a few pixels inside of it, with more contrast than the outline
    itself, and plain paint looks the same at any disparity: what makes U edges hard.
    """
    width, height, belt = d * rng.uniform(1.5, 4), d * rng.uniform(2.2, 3), rng.uniform(0.4, 0.55)
    top, middle, low = foot - height, foot - height * belt, foot - height * 0.12
    roof, arch, slant = rng.uniform(0.5, 0.85), rng.uniform(0, 0.12) * height, rng.uniform(-0.3, 0.3) * width

    def cabin(x, y, inset=0.0):
        part = np.clip((y - top) / (middle - top), 0, 1)
        middle_x = cx + slant * 0.5 * (1 - part)
        half = width * (roof + (0.95 - roof) * part) - 1.2 * inset
        crown = top + arch * ((x - middle_x) / width) ** 2
        return np.minimum(np.minimum(y - crown - inset, middle - y + 0.5 * inset), 0.8 * (half - np.abs(x - middle_x)))

    body = rectangle(cx, 0.5 * (middle + low), width, 0.5 * (low - middle) + 1)

    def inside(x, y):
        return np.maximum(cabin(x, y), body(x, y))

    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    paint = rng.choice([30, 60, 120, 190, 235]) + rng.uniform(-20, 20, 3)
    picture = (
        np.tile(paint, (HEIGHT, WIDTH, 1)) * (1 + 0.15 * np.sin((y - top) / height * 5 + rng.uniform(0, 6)))[..., None]
    )

    def lay(f: Float, colour: Float) -> None:
        alpha = np.clip(0.5 + f, 0, 1)[..., None]
        picture[...] += alpha * (colour - picture)

    glass = rng.uniform(20, 70) + rng.uniform(0.1, 0.4) * (np.roll(texture, rng.integers(0, WIDTH), 1) - 128)
    lay(cabin(x, y, max(1.5, height * rng.uniform(0.03, 0.09))), glass)
    for pillar in rng.uniform(-0.7, 0.7, rng.integers(0, 3)):
        lay(np.minimum(max(0.7, 0.03 * width) - np.abs(x - cx - pillar * width), cabin(x, y)), paint)
    lay(rectangle(cx, middle, width, max(0.4, 0.01 * height))(x, y), 0.6 * paint)
    lay(rectangle(cx, low - 0.1 * height, width, max(0.5, 0.03 * height))(x, y), 0.5 * paint)
    for wheel in (-0.6, 0.6):
        lay(0.17 * height - np.hypot(x - cx - wheel * width, y - low + 0.06 * height), np.full(3, 25.0))
        lay(
            rectangle(cx + 1.5 * wheel * width, middle + 0.1 * height, 0.08 * width, 0.04 * height)(x, y),
            rng.uniform(0, 255, 3),
        )
    return np.clip(picture, 0, 255).astype(np.float32), inside


def everywhere(x, y):
    return np.full(np.broadcast(x, y).shape, 1e3)


def sample(texture: Float, x: Float, y: Float) -> Float:
    return cv2.remap(
        texture, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LANCZOS4, borderMode=cv2.BORDER_REFLECT
    )


def render(layers: list[Layer], right: bool, blur: float, tilt: tuple[float, float] = (0.0, 0.0)) -> Float:
    """Return one view (H, W, 3): layers back to front, each pixel mapped to the left view by the layer's plane.

    `tilt` is what rectification leaves: rows shifted by tilt[0] px, and by tilt[1] px more from centre to border.
    """
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    y += tilt[0] + tilt[1] * (2 * x / WIDTH - 1)
    out = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    for layer in layers:
        a, b, c = layer.plane
        # x_right = x - a - b x - c y, solved for x; a ground layer is flat above the horizon.
        at = (x + a + c * y) / (1 - b) if right else x
        if layer.inside is everywhere and right:
            at = x + np.maximum(layer.disparity(x, y), 0.0)
        alpha = np.clip(0.5 + layer.inside(at, y), 0, 1)[..., None].astype(np.float32)
        box = cv2.boundingRect((alpha[..., 0] > 0).astype(np.uint8))
        cut = np.s_[box[1] : box[1] + box[3], box[0] : box[0] + box[2]]
        if box[2] and box[3]:
            colour = sample(layer.texture, at[cut] + layer.offset[0], y[cut] + layer.offset[1])
            out[cut] += alpha[cut] * (colour - out[cut])
    return cv2.GaussianBlur(out, (0, 0), blur)


def truth_of(layers: list[Layer]) -> tuple[Truth, Float]:
    """Return every silhouette point of the left view and its disparity (H, W)."""
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    top = np.zeros((HEIGHT, WIDTH), int)
    depth = np.maximum(layers[0].disparity(x, y), 0.0)
    field = np.stack([layer.inside(x, y) for layer in layers])
    for number, layer in enumerate(layers[1:], 1):
        shown = field[number] > 0
        top[shown], depth[shown] = number, layer.disparity(x, y)[shown]
    uv, side, jump = [], [], []
    for s in SIDES:
        du, dv = s.background
        v, u = np.nonzero(np.ones_like(top, bool))
        ok = (u + du >= 0) & (u + du < WIDTH) & (v + dv >= 0) & (v + dv < HEIGHT)
        v, u = v[ok], u[ok]
        front = top[v, u]
        step = depth[v, u] - depth[v + dv, u + du]
        ok = (front > top[v + dv, u + du]) & (step > 1.0)
        v, u, front, step = v[ok], u[ok], front[ok], step[ok]
        here, there = field[front, v, u], field[front, v + dv, u + du]
        part = here / (here - there)
        uv.append(np.stack([u + part * du, v + part * dv], 1))
        side.append(np.full(len(u), s, np.int8))
        jump.append(step)
    return Truth(np.concatenate(uv), np.concatenate(side), np.concatenate(jump)), depth


def procedural_textures(rng: np.random.Generator) -> list[Float]:
    """Noise over many scales with patches: a stand-in for street images."""
    out = []
    for _ in range(6):
        picture = np.zeros((HEIGHT, WIDTH, 3), np.float32) + rng.uniform(60, 180, 3).astype(np.float32)
        for size in (4, 16, 64, 200):
            grid = rng.normal(size=(HEIGHT // size + 3, WIDTH // size + 3, 3)).astype(np.float32)
            picture += rng.uniform(3, 18) * cv2.resize(grid, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
        for _ in range(60):
            u, v, w, h = rng.integers(0, [WIDTH, HEIGHT, 150, 60])
            picture[v : v + h, u : u + w] += rng.uniform(-50, 50, 3)
        out.append(np.clip(cv2.GaussianBlur(picture, (0, 0), 0.5), 0, 255))
    return out


def street_textures(root: Path, drives: list[str]) -> list[Float]:
    paths = sorted(p for d in drives for p in root.glob(f"*/*_drive_{d}_sync/image_02/data/*"))
    pictures = [cv2.imread(str(p))[..., ::-1].astype(np.float32) for p in paths]
    if not pictures:
        raise SystemExit(f"no left pictures of drives {' '.join(drives)} below {root}")
    return pictures


def scene(rng: np.random.Generator, textures: list[Float]) -> list[Layer]:
    """Return random layers back to front: ground and far background, then poles, boxes, signs and blobs."""
    back = textures[rng.integers(len(textures))].copy()
    horizon, slope = HORIZON + rng.uniform(-8, 8), rng.uniform(0.25, 0.38)
    if rng.random() < 0.5:
        end = int(horizon - rng.uniform(15, 60))
        low, high = rng.uniform(170, 250, 3), rng.uniform(120, 250, 3)
        ramp = np.linspace(0, 1, end)[:, None, None]
        back[:end] = high + (low - high) * ramp + rng.normal(size=(end, back.shape[1], 1))
    layers = [Layer(back, tuple(rng.uniform(0, 1, 2)), (-slope * horizon, 0.0, slope), everywhere)]
    for d in np.sort(np.exp(rng.uniform(np.log(5), np.log(70), rng.integers(9, 15)))):
        texture = textures[rng.integers(len(textures))]
        cx, foot = rng.uniform(0, WIDTH), horizon + d / slope
        kind = rng.choice(["pole", "box", "sign", "blob", "car", "car"])
        tilt = rng.uniform(-0.08, 0.08) * (rng.random() < 0.5)
        if kind == "car":
            paint, inside = car(rng, texture, cx, foot, d)
            layers.append(Layer(paint, tuple(rng.uniform(0, 1, 2)), (d, 0.0, 0.0), inside))
            continue
        if kind == "pole":
            w, h = max(1.5, d * rng.uniform(0.1, 0.4)), d * rng.uniform(4, 10)
            inside, tilt = rectangle(cx, foot - h / 2, w, h / 2, rng.normal() * 0.02), 0.0
        elif kind == "box":
            w, h = d * rng.uniform(1, 4), d * rng.uniform(2, 6)
            inside = rectangle(cx, foot - h / 2, w, h / 2, rng.normal() * 0.03)
        elif kind == "sign":
            w, h = d * rng.uniform(0.5, 2), d * rng.uniform(0.5, 2)
            inside = rectangle(cx, foot - d * rng.uniform(2, 6), w, h, rng.uniform(-0.8, 0.8))
        else:
            w, h = d * rng.uniform(1, 4), d * rng.uniform(1, 3)
            outline = rng.uniform(0, 0.16, 4) / np.arange(1, 5)
            inside = blob(cx, foot - h * rng.uniform(0.6, 1.5), w, h, outline, rng.uniform(0, 6.28, 4))
        layers.append(Layer(texture, tuple(rng.uniform(-300, 300, 2)), (d - tilt * cx, tilt, 0.0), inside))
    return layers


def pair(rng: np.random.Generator, textures: list[Float]) -> tuple[Image, Truth, Float]:
    """Return a pair as two cameras of one rig would take it, its silhouettes and the left disparity (H, W)."""
    layers, blur = scene(rng, textures), rng.uniform(0.4, 0.6)
    views: list[UInt8] = []
    for right in (False, True):
        tilt = tuple(rng.uniform(-0.2, 0.2, 2)) if right else (0.0, 0.0)
        view = render(layers, right, blur * (rng.uniform(1.0, 1.3) if right else 1.0), tilt)
        if right:
            view = view * rng.uniform(0.95, 1.05) + rng.uniform(-3, 3)
        view = np.clip(view + rng.normal(0, 1.5, view.shape), 0, 255).round().astype(np.uint8)
        if right:
            _, code = cv2.imencode(".jpg", view[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])
            view = np.ascontiguousarray(cv2.imdecode(code, cv2.IMREAD_COLOR)[..., ::-1])
        views.append(view)
    camera = Camera.pinhole(721.5, 721.5, 609.6, HORIZON, WIDTH, HEIGHT)
    truth, disparity = truth_of(layers)
    return Image(views[0], camera, right=views[1], baseline_m=0.54), truth, disparity


def plain_sgbm(image: Image) -> ImageEdges:
    """The usual way: SGBM, holes filled with background, median filter, jumps of more than 2 px and 12 %."""
    pad = 128
    matcher = cv2.StereoSGBM.create(0, pad, 5, 8 * 25, 32 * 25, 1, 31, 10, 100, 2, cv2.STEREO_SGBM_MODE_SGBM_3WAY)
    both = [cv2.copyMakeBorder(p, 0, 0, pad, 0, cv2.BORDER_REPLICATE) for p in (image.rgb, image.right)]
    raw = matcher.compute(*both)[:, pad:].astype(np.float32) / 16
    known, column = raw >= 0, np.arange(raw.shape[1])
    before = np.maximum.accumulate(np.where(known, column, -1), axis=1)
    after = np.minimum.accumulate(np.where(known, column, raw.shape[1])[:, ::-1], axis=1)[:, ::-1]
    padded = np.pad(np.where(known, raw, np.inf), ((0, 0), (1, 1)), constant_values=np.inf)
    rows = np.arange(len(raw))[:, None]
    filled = np.minimum(padded[rows, before + 1], padded[rows, after + 1])
    disparity = cv2.medianBlur(np.where(np.isfinite(filled), filled, 0).astype(np.float32), 5)
    uv, side = [], []
    for s in SIDES:
        du, dv = s.background
        axis, step = (1, du) if du else (0, dv)
        beside, behind, inner = (np.roll(disparity, -n * step, axis) for n in (1, 2, -3))
        jump = disparity - np.minimum(behind, beside)
        near = (jump > 2) & (jump > 0.12 * disparity) & (disparity - beside >= 0.5 * jump)
        near &= np.abs(inner - disparity) < 0.3 * jump
        near[:3], near[-3:], near[:, :3], near[:, -3:] = False, False, False, False
        v, u = np.nonzero(near)
        uv.append(np.stack([u + 0.5 * du, v + 0.5 * dv], axis=1))
        side.append(np.full(len(u), s, np.int8))
    return ImageEdges(np.concatenate(uv), np.concatenate(side))


def compare(edges: ImageEdges, truth: Truth) -> dict[Side, dict[str, Float]]:
    """Return for each direction: `hit` of every edge, `found` of every silhouette (3 px), signed `offset` in px."""
    from scipy.spatial import cKDTree

    out = {}
    for s in SIDES:
        mine, real, jump = edges.uv[edges.side == s], truth.uv[truth.side == s], truth.jump[truth.side == s]
        # Offsets along the axis of the direction only: stretch the other axis, so that only the same line pairs.
        axis = 0 if s.background[0] else 1
        scale = np.where(np.arange(2) == axis, 1.0, 20.0)
        gap, row = (
            cKDTree(real * scale).query(mine * scale) if len(real) and len(mine) else (np.zeros(0), np.zeros(0, int))
        )
        offset = (mine - real[row])[:, axis] if len(row) else np.zeros(0)
        hit = cKDTree(real).query(mine)[0] <= 3 if len(real) and len(mine) else np.zeros(len(mine), bool)
        strong = real[jump > 3]
        found = cKDTree(mine).query(strong)[0] <= 3 if len(strong) and len(mine) else np.zeros(len(strong), bool)
        out[s] = {"hit": hit, "found": found, "offset": offset[gap <= 5], "weight": edges.weight[edges.side == s]}
    return out


def logistic(x: Float, y: Float, ridge: float = 1e-4) -> Float:
    """Return coefficients (D,) of a logistic regression of y (N,) in 0..1 on x (N, D), by Newton's method."""
    beta = np.zeros(x.shape[1])
    for _ in range(30):
        p = 1 / (1 + np.exp(-x @ beta))
        hessian = (x * (p * (1 - p))[:, None]).T @ x + ridge * len(y) * np.eye(len(beta))
        beta += np.linalg.solve(hessian, x.T @ (y - p) - ridge * len(y) * beta)
    return beta


def fit(pairs: list[tuple[Image, Truth, Float]], options: stereo.StereoOptions) -> None:
    """Print the coefficients of silhouette.JUDGEMENT: is a silhouette within 1 px of a true one of its direction?"""
    from scipy.spatial import cKDTree

    found = [stereo.silhouettes(image.rgb, image.right, image.baseline_m, options) for image, _, _ in pairs]
    for sides in (SIDES[:2], SIDES[2:3], SIDES[3:]):
        parts = [
            (f[s], s, cKDTree(t.uv[t.side == s])) for f, (_, t, _) in zip(found, pairs, strict=True) for s in sides
        ]
        x = np.concatenate([np.column_stack([p.features, np.ones(len(p.uv))]) for p, _, _ in parts])
        y = np.concatenate([tree.query(p.uv)[0] < 1 for p, _, tree in parts]).astype(float)
        own = logistic(x, y)
        first = x @ own
        belief = np.split(1 / (1 + np.exp(-first)), np.cumsum([len(p.uv) for p, _, _ in parts])[:-1])
        beside = [silhouette.support(p.uv, b, s, (HEIGHT, WIDTH)) for (p, s, _), b in zip(parts, belief, strict=True)]
        joint = logistic(np.column_stack([first, np.concatenate(beside), np.ones(len(y))]), y)
        print("".join(s.letter for s in sides), *("(" + ", ".join(f"{b:.2f}" for b in c) + ")," for c in (own, joint)))


def table(name: str, rows: list[dict[Side, dict[str, Float]]], seconds: float) -> None:
    print(f"\n{name}: {seconds:.2f} s a pair")
    print("side   edges  precision  recall  median px  mean px  MAD px  within 1 px")
    for s in SIDES:
        hit, found, offset = (np.concatenate([r[s][k] for r in rows]) for k in ("hit", "found", "offset"))
        middle = np.median(offset) if len(offset) else np.nan
        spread = np.median(np.abs(offset - middle)) if len(offset) else np.nan
        close = offset[np.abs(offset) <= 3]
        print(
            f"{s.letter:>4} {len(hit) / len(rows):7.0f} {hit.mean():10.3f} {found.mean():7.3f} {middle:+10.3f} "
            f"{close.mean():+8.3f} {spread:7.3f} {(np.abs(close) <= 1).sum() / max(len(hit), 1):12.3f}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, help="root of KITTI raw; procedural textures without it")
    parser.add_argument(
        "--drives", help=f"drives whose left pictures are cut up ({CHECKING_DRIVES}; to fit {FITTING_DRIVES})"
    )
    parser.add_argument("--pairs", type=int, default=24)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="options of the extractor")
    parser.add_argument("--only", choices=["plain", "ours"], help="measure one of the two")
    parser.add_argument("--fit", action="store_true", help="fit the coefficients of the confidence and print them")
    parser.add_argument("--draw", type=Path, help="write overlays of the pairs into this folder")
    arguments = parser.parse_args()
    rng = np.random.default_rng(arguments.seed)
    drives = arguments.drives or (FITTING_DRIVES if arguments.fit else CHECKING_DRIVES)
    textures = street_textures(arguments.data, drives.split()) if arguments.data else procedural_textures(rng)
    options = stereo.StereoOptions(**dict(item.split("=", 1) for item in arguments.set))
    ours = stereo.build(options)
    methods = {"plain": plain_sgbm, "ours": lambda image: ours(image).edges}
    if arguments.only:
        methods = {arguments.only: methods[arguments.only]}
    if arguments.fit:
        fit([pair(rng, textures) for _ in range(arguments.pairs)], options)
        return
    rows: dict[str, list] = {name: [] for name in methods}
    seconds = dict.fromkeys(methods, 0.0)
    for number in range(arguments.pairs):
        image, truth, _ = pair(rng, textures)
        for name, method in methods.items():
            start = time.perf_counter()
            edges = method(image)
            seconds[name] += time.perf_counter() - start
            rows[name].append(compare(edges, truth))
            if arguments.draw:
                draw(image, edges, truth, arguments.draw / f"{number:02d}-{name}.png")
    for name in methods:
        table(name, rows[name], seconds[name] / arguments.pairs)


def draw(image: Image, edges: ImageEdges, truth: Truth, path: Path) -> None:
    """Write the image at twice its size, silhouettes white, edges in the colours of their directions."""
    colours = {Side.LEFT: (0, 255, 0), Side.RIGHT: (0, 0, 255), Side.UPPER: (0, 255, 255), Side.BOTTOM: (255, 0, 0)}
    canvas = cv2.resize(image.rgb[..., ::-1], None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST) // 2 + 50
    for uv, colour in [(truth.uv, dict.fromkeys(SIDES, (255, 255, 255))), (edges.uv, colours)]:
        sides = truth.side if uv is truth.uv else edges.side
        place = np.round(2 * uv + 0.5).astype(int)
        inside = ((place >= 0) & (place < [2 * WIDTH, 2 * HEIGHT])).all(1)
        for s in SIDES:
            at = place[inside & (sides == s)]
            canvas[at[:, 1], at[:, 0]] = colour[s]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), canvas)


if __name__ == "__main__":
    main()
