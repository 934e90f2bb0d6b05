"""Carrier and distractor of the object: sections of a scenario."""

import dataclasses as dc

from feasigrasp.models.choices import key, word
from feasigrasp.models.objects.distractor_bodies import CarrierKind


@dc.dataclass
class CarrierConfig:
    """Carrier of the object. It releases after the fingers have closed, and withdraws.

    The cameras see it; nothing touches it.

    Attributes:
        kind: ``none``; ``hand``, fingers that hold the object from the side turned away from the
            arm, and a forearm behind them; ``belt``, a level plate under it.
        hue: Hue of it, as of a glove, by which ``segmentation: depth`` separates it from the object
            [deg]: 0 is red, 120 green, 240 blue. Unless it is given nothing does; where the cell is
            simulated it has the colour of skin then.
    """

    kind: str = word(CarrierKind.NONE, CarrierKind)
    hue: float | None = key(None, 0.0, 360.0, "deg")


@dc.dataclass
class DistractorConfig:
    """Another object in the air, which is not to be grasped.

    The cameras see it; nothing touches it.

    Attributes:
        model: Name of a built-in object, or a path to a mesh; there is none if it is empty.
        offset: Where it is, along the axes of the world [m]: from the object if it moves, else from
            the middle of the object's path.
        moving: Whether it moves with the object.
    """

    model: str = ""
    offset: list[float] = key([0.0, 0.15, 0.0], -2.0, 2.0, "m")
    moving: bool = False
