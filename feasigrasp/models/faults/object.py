"""Disturbances of the object: change of speed, jump, external force."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from feasigrasp.models.arrays import Array
from feasigrasp.models.choices import key
from feasigrasp.models.faults.fault import Fault
from feasigrasp.models.objects.motion import ObjectMotion


@dataclass
class ObjectFault(Fault):
    """A change of the object's motion, which begins and ends smoothly; derive from it.

    Attributes:
        ramp: How long the change itself takes, at the beginning and after the end [s].
    """

    ramp: float = key(0.2, 0.01, 100.0, "s")

    def changes(self, t: float) -> tuple[list[tuple[float, float]], int]:
        """How long ago each change until time t was [s], and 1 for on or -1 for off.

        Without those of times that are over altogether; and the number of these.
        """
        n = 1 + int((t - self.start) // self.every) if t > self.start else 0
        found: list[tuple[float, float]] = []
        for k in reversed(range(n)):
            elapsed = t - self.start - (k * self.every if k else 0.0)
            if elapsed - self.duration >= self.ramp:
                return found, k + 1
            found.append((elapsed, 1.0))
            if elapsed > self.duration:
                found.append((elapsed - self.duration, -1.0))
        return found, 0


@dataclass
class ObjectPace(ObjectFault):
    """The object goes on along its path, but quicker, slower or backwards.

    Attributes:
        factor: Of its speed: 0 stops it, -1 turns it back.
    """

    factor: float = key(0.0, -20.0, 20.0)

    def own_time(self, t: float) -> tuple[float, float, float]:
        """Offset of the path time at time t [s], and its first two derivatives."""
        changes, over = self.changes(t)
        added, rate, change = over * self.duration if over else 0.0, 0.0, 0.0
        for elapsed, sign in changes:
            on = min(elapsed, self.ramp)
            added += sign * (on**2 / (2.0 * self.ramp) + elapsed - on)
            rate += sign * on / self.ramp
            change += sign * float(elapsed < self.ramp) / self.ramp
        more = self.factor - 1.0
        return more * added, more * rate, more * change


@dataclass
class ObjectMoved(ObjectFault):
    """The object leaves its path for one place, and comes back when the fault ends.

    Attributes:
        to: The place of its centre, in the world [m].
        ramp: How long it takes there, and back [s].
    """

    to: list[float] = key([1.3, 0.0, 0.55], -10.0, 10.0, "m")
    ramp: float = key(1.5, 0.01, 100.0, "s")

    def share(self, t: float) -> tuple[float, float, float]:
        """Share of the displacement at time t, from 0 to 1, and its first two derivatives."""
        share = rate = change = 0.0
        for elapsed, sign in self.changes(t)[0]:
            s = min(elapsed / self.ramp, 1.0)
            share += sign * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
            rate += sign * 30.0 * s**2 * (1.0 - s) ** 2 / self.ramp
            change += sign * 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self.ramp**2
        return share, rate, change


@dataclass
class ObjectPulled(Fault):
    """External force on the object after its release.

    Attributes:
        force: In the world, at the object's origin [N].
        speed: Who pulls lets go of an object that is faster [m/s].
    """

    duration: float = key(0.5, 0.0, math.inf, "s")
    force: list[float] = key([0.0, 0.0, -150.0], -1000.0, 1000.0, "N")
    speed: float = key(2.0, 0.01, 20.0, "m/s")

    def pulls(self, t: float, speed: float) -> bool:
        """Whether it pulls at time t [s] at an object with that speed [m/s]."""
        return self.active(t) and speed <= self.speed


@dataclass(frozen=True)
class AlteredMotion(ObjectMotion):
    """A motion with faults: first those of its pace, then those of its place.

    Attributes:
        motion: The motion without them.
        faults: The faults.
    """

    motion: ObjectMotion
    faults: Sequence[ObjectFault]

    def state(self, t: float) -> tuple[Array, Array, Array]:
        """``X_WO`` (4, 4), ``V_WO`` (6,) and the acceleration of the origin (3,) at time t [s].

        With the time s(t) along the path, velocity and acceleration are ``v(s) s'`` and
        ``a(s) s'^2 + v(s) s''``; with the share w(t) of the way to a place c, the position is
        ``(1 - w) p + w c``, and its derivatives follow.
        """
        s, rate, change = t, 1.0, 0.0
        for fault in self.faults:
            if isinstance(fault, ObjectPace):
                s, rate, change = np.add((s, rate, change), fault.own_time(t))
        X, V, a = self.motion.state(s)
        a = rate**2 * a + change * V[3:]
        V = rate * V
        for fault in self.faults:
            if isinstance(fault, ObjectMoved):
                w, dw, ddw = fault.share(t)
                to_place, v = np.asarray(fault.to) - X[:3, 3], V[3:].copy()
                X[:3, 3] += w * to_place
                V[3:] = (1.0 - w) * v + dw * to_place
                a = (1.0 - w) * a - 2.0 * dw * v + ddw * to_place
        return X, V, a


def altered(motion: ObjectMotion, faults: Sequence[object]) -> ObjectMotion:
    """The motion with those of some faults that alter it; itself if none does."""
    own = [fault for fault in faults if isinstance(fault, ObjectFault)]
    return AlteredMotion(motion, own) if own else motion
