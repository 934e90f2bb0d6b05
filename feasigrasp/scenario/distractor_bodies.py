"""Carrier and distractor of the object: sections of a scenario."""

import dataclasses as dc

from feasigrasp.models.choices import key, word
from feasigrasp.models.objects.distractor_bodies import CarrierKind
from feasigrasp.models.objects.spring_drive import SPRINGS, CarrierHold, Compliance, Release


@dc.dataclass
class CarrierConfig:
    """Carrier of the object. It releases after the fingers have closed, and withdraws.

    The cameras see it; nothing touches it.

    Attributes:
        stiffness: How firmly it holds the object: as a relaxed hand (300 N/m, 3 Nm/rad), a tensed
            one (1000 N/m, 10 Nm/rad), or a robot's flange (10 kN/m, 100 Nm/rad).
        release: When it lets go after the fingers have squeezed: ``late``, by ``release_delay``;
            ``load``, once it bears less than half of the weight.
        release_delay: Reaction time of a ``late`` release [s].
        kind: ``none``; ``hand``, fingers that hold the object from the side turned away from the
            arm, and a forearm behind them; ``belt``, a level plate under it.
        hue: Hue of it, as of a glove, by which ``segmentation: depth`` separates it from the object
            [deg]: 0 is red, 120 green, 240 blue. Unless it is given nothing does; where the cell is
            simulated it has the colour of skin then.
    """

    stiffness: str = word(Compliance.STIFF, Compliance)
    release: str = word(Release.LATE, Release)
    release_delay: float = key(0.3, 0.0, 10.0, "s")
    kind: str = word(CarrierKind.NONE, CarrierKind)
    hue: float | None = key(None, 0.0, 360.0, "deg")

    @property
    def hold(self) -> CarrierHold:
        """How it holds the object, and lets it go."""
        spring = SPRINGS[Compliance(self.stiffness)]
        return CarrierHold(spring, Release(self.release), self.release_delay)


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
