"""The built-in objects: what each is made of, mass, colour and surface. Metres, kilograms, z up."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import compounds
import lathed
from manifold3d import Manifold


@dataclass(frozen=True)
class Item:
    """One object of the catalogue."""

    name: str
    make: Callable[[], Manifold]
    mass: float
    color: tuple[float, float, float]
    description: str
    material: str = "matt"


OBJECTS = (
    Item("apple", lathed.apple, 0.17, (0.72, 0.12, 0.12), "apple with stem, 72 mm wide"),
    Item("ball", lathed.ball, 0.06, (0.78, 0.85, 0.20), "ball, 66 mm wide"),
    Item("banana", lathed.banana, 0.12, (0.95, 0.80, 0.16), "banana, 35 mm thick"),
    Item("bowl", lathed.bowl, 0.15, (0.80, 0.30, 0.20), "bowl, 140 mm wide, wall 4 mm"),
    Item("box", compounds.box, 0.45, (0.86, 0.72, 0.28), "carton, 90 x 45 x 170 mm"),
    Item("cup", lathed.cup, 0.06, (0.25, 0.62, 0.45), "tapered cup, hollow, wall 3 mm"),
    Item("drill", compounds.drill, 0.60, (0.90, 0.45, 0.10), "cordless drill"),
    Item("duck", compounds.duck, 0.06, (0.98, 0.80, 0.10), "bath duck, 58 x 41 x 54 mm"),
    Item("hammer", compounds.hammer, 0.50, (0.45, 0.30, 0.20), "claw hammer, 240 mm long", "dark"),
    Item("l_block", compounds.l_block, 0.28, (0.60, 0.45, 0.75), "L-shaped block, 40 mm thick"),
    Item(
        "mug",
        compounds.mug,
        0.30,
        (0.20, 0.42, 0.66),
        "mug with handle, hollow, wall 4 mm",
        "shiny",
    ),
    Item("mustard_bottle", lathed.mustard_bottle, 0.42, (0.93, 0.74, 0.10), "oval squeeze bottle"),
    Item("pear", lathed.pear, 0.16, (0.66, 0.74, 0.24), "pear with stem, 65 mm wide"),
    Item(
        "screwdriver",
        lathed.screwdriver,
        0.10,
        (0.80, 0.20, 0.15),
        "screwdriver, 210 mm long",
        "shiny",
    ),
    Item("small_box", compounds.small_box, 0.12, (0.55, 0.33, 0.20), "carton, 80 x 60 x 35 mm"),
    Item("soup_can", lathed.soup_can, 0.35, (0.78, 0.16, 0.14), "food can, 67 mm wide", "shiny"),
    Item("spray_can", lathed.spray_can, 0.28, (0.30, 0.55, 0.75), "spray can, 53 mm wide", "shiny"),
    Item(
        "water_bottle",
        lathed.water_bottle,
        0.52,
        (0.55, 0.75, 0.88),
        "bottle, 64 mm wide",
        "transparent",
    ),
)
