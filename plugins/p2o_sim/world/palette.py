"""Materials and colours that several things share. Colours are linear RGB."""

from __future__ import annotations

import numpy as np

from p2o_sim.world.lighting import Triple, triple
from p2o_sim.world.scene import Material

ASPHALT = Material("asphalt", (0.12, 0.12, 0.122), contrast=0.6, reflectance=0.2, pattern="asphalt")
PAVING = Material("paving", (0.22, 0.21, 0.19), contrast=0.5, reflectance=0.3, pattern="slabs")
PAINT = Material("road paint", (0.6, 0.6, 0.57), contrast=0.7, reflectance=0.8, pattern="asphalt")
KERB = Material("kerb", (0.27, 0.26, 0.24), contrast=0.5, reflectance=0.4)
GRASS = Material("grass", (0.1, 0.13, 0.035), contrast=0.6, reflectance=0.4, pattern="grass")
SOIL = Material("soil", (0.12, 0.1, 0.06), contrast=0.6, reflectance=0.35, pattern="grass")
GLASS = Material("glass", (0.02, 0.025, 0.03), contrast=0.3, reflectance=0.02, gloss=0.75, pattern="plain")
FRAME = Material("window frame", (0.62, 0.61, 0.57), contrast=0.2, reflectance=0.6, pattern="plain")
STONE = Material("stone", (0.34, 0.32, 0.29), contrast=0.5, reflectance=0.45)
CONCRETE = Material("concrete", (0.36, 0.35, 0.33), contrast=0.5, reflectance=0.4)
TYRE = Material("tyre", (0.015, 0.015, 0.016), contrast=0.3, reflectance=0.04, pattern="plain")
RIM = Material("rim", (0.2, 0.205, 0.21), contrast=0.4, reflectance=0.6, gloss=0.2)
TRIM = Material("trim", (0.02, 0.02, 0.022), contrast=0.3, reflectance=0.06, pattern="plain")
HEADLIGHT = Material("headlight", (0.6, 0.6, 0.6), contrast=0.3, reflectance=0.8, gloss=0.4, pattern="plain")
TAIL_LIGHT = Material("tail light", (0.35, 0.01, 0.01), contrast=0.3, reflectance=0.7, gloss=0.2, pattern="plain")
PLATE = Material("plate", (0.7, 0.7, 0.66), contrast=0.2, reflectance=0.95, pattern="plain")
STEEL = Material("steel", (0.3, 0.31, 0.32), contrast=0.4, reflectance=0.5, gloss=0.1)
DARK_STEEL = Material("dark steel", (0.045, 0.05, 0.05), contrast=0.4, reflectance=0.2, gloss=0.1)
BARK = Material("bark", (0.1, 0.08, 0.055), contrast=0.8, reflectance=0.35, pattern="streaks")
WOOD = Material("wood", (0.25, 0.16, 0.09), contrast=0.6, reflectance=0.5, pattern="streaks")
SKIN = Material("skin", (0.5, 0.32, 0.24), contrast=0.1, reflectance=0.5, pattern="plain")
RUBBER = Material("rubber", (0.03, 0.03, 0.03), contrast=0.2, reflectance=0.1, pattern="plain")
SIGN_BACK = Material("sign back", (0.3, 0.31, 0.32), contrast=0.2, reflectance=0.5, gloss=0.2, pattern="plain")

WALLS = (
    (0.55, 0.45, 0.32), (0.3, 0.12, 0.08), (0.62, 0.58, 0.5), (0.4, 0.41, 0.42), (0.6, 0.5, 0.38), (0.42, 0.46, 0.44),
    (0.7, 0.68, 0.64),
)  # fmt: skip
LACQUER = (
    (0.42, 0.43, 0.44), (0.25, 0.02, 0.02), (0.02, 0.05, 0.16), (0.7, 0.7, 0.69), (0.012, 0.013, 0.015),
    (0.012, 0.013, 0.015), (0.1, 0.1, 0.11), (0.05, 0.12, 0.1), (0.5, 0.4, 0.1), (0.22, 0.23, 0.25),
    (0.08, 0.085, 0.09), (0.03, 0.035, 0.06), (0.6, 0.6, 0.58),
)  # fmt: skip
SIGNS = ((0.5, 0.03, 0.03), (0.03, 0.12, 0.42), (0.75, 0.74, 0.7), (0.68, 0.5, 0.04))
CLOTH = (
    (0.06, 0.07, 0.12), (0.4, 0.1, 0.08), (0.5, 0.47, 0.4), (0.05, 0.12, 0.1), (0.02, 0.02, 0.025), (0.2, 0.22, 0.3),
)  # fmt: skip


def pick(rng: np.random.Generator, colours: tuple[Triple, ...]) -> Triple:
    """Return one of the colours, with a random change of brightness."""
    return triple(np.array(colours[rng.integers(len(colours))]) * rng.uniform(0.85, 1.15))


def lacquer(rng: np.random.Generator) -> Material:
    """Return the paint of a car; dark paint reflects little energy to a LiDAR."""
    colour = pick(rng, LACQUER)
    return Material("lacquer", colour, 0.15, reflectance=0.03 + 0.8 * (sum(colour) / 3), gloss=0.3, pattern="plain")
