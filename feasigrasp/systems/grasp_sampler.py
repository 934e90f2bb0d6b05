"""Samples grasps from the distance field of the object."""

from dataclasses import dataclass, replace

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.errors import GraspError
from feasigrasp.models.arguments import checked
from feasigrasp.models.arrays import Frozen
from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.grasps.non_maximum_suppression import GraspHistory
from feasigrasp.models.grasps.payload import with_loads
from feasigrasp.models.grasps.samplers import recheck_of
from feasigrasp.models.quantities import NotNegative, Positive
from feasigrasp.models.robot.gripper import Gripper
from feasigrasp.models.shape.gpdf import Gpdf
from feasigrasp.systems.ports import (
    PeriodicState,
    declare_cache,
    declare_input,
    declare_output,
    evaluate,
)


@dataclass(frozen=True, eq=False)
class _Sampled(Frozen):
    """Grasps up to a field, and when they were found [s]."""

    history: GraspHistory
    time: float = -np.inf


class GraspSampler(LeafSystem):
    """Samples and filters grasps per distance field, with data association.

    .. pydrake_system::

        name: GraspSampler
        input_ports: [gpdf]
        output_ports: [grasps]

    ``gpdf`` is a `Gpdf` or None (nothing seen yet), ``grasps`` a `GraspSet` in the same frame, with
    the reason and count of every rejection; empty before the first view. Any callable from a field
    to a grasp set can be the sampler.

    With a hand, grasps know what its pads would have to bear (`GraspSet.load`).

    Grasps keep their ``id`` from field to field, and their pose as long as they pass the filter on
    the new one. The output is a function of the field and of the state, which is the history up to
    the field before; it is brought up to date every ``period`` seconds, so fields may not change
    more often than that. Of fields that come more often than every ``rest`` seconds, some are
    passed over.
    """

    @checked(GraspError)
    def __init__(
        self,
        sampler: GraspSamplerFn,
        gripper: Gripper | None = None,
        *,
        mass: Positive | None = None,
        period: Positive = 0.05,
        rest: NotNegative = 0.0,
    ) -> None:
        """A system around one sampler, e.g. `AntipodalSampler`.

        Args:
            sampler: From a field to its grasps.
            gripper: The hand that grasps of earlier fields are checked with; without it they are
                not kept, and new grasps beside them have their ids.
            mass: Mass of the object, if it is known [kg].
            period: Time between updates of the history [s].
            rest: After grasps were sampled, no other field is looked at for so long [s].

        Raises:
            GraspError: The sampler cannot be called; later, that it returned no grasp set.
        """
        super().__init__()
        self._sampler = sampler
        self._recheck = None if gripper is None else recheck_of(gripper)
        self._gripper, self._mass = gripper, mass
        self._gpdf = declare_input(self, "gpdf", kind=Gpdf | None)
        self._rest = rest
        self._before = PeriodicState(self, _Sampled(GraspHistory()), period, self._update)
        inputs = {self._gpdf, self._before}
        self._now = declare_cache(self, "grasps of the present field", self._calc_history, inputs)
        declare_output(self, "grasps", self._calc, {self._now})

    def _update(self, context: Context) -> _Sampled:
        before: _Sampled = self._before.Eval(context)
        history, time = self._now.Eval(context), context.get_time()
        if self._rests(before) and time >= before.time + self._rest - 1e-9:
            history = self._followed(history, evaluate(self._gpdf, context))
        return before if history is before.history else _Sampled(history, time)

    def _calc_history(self, context: Context) -> GraspHistory:
        before: _Sampled = self._before.Eval(context)
        if self._rests(before):
            return before.history  # the next field is taken in an update
        return self._followed(before.history, evaluate(self._gpdf, context))

    def _rests(self, sampled: _Sampled) -> bool:
        return self._rest > 0.0 and sampled.history.gpdf is not None

    def _followed(self, before: GraspHistory, gpdf: Gpdf | None) -> GraspHistory:
        if gpdf is None or gpdf is before.gpdf:
            return before
        found = self._sampler(gpdf)
        if not isinstance(found, GraspSet):
            raise GraspError(
                f"the sampler {self._sampler!r} returned {type(found).__name__}; have it return a "
                "GraspSet, an empty one if there is no grasp"
            )
        history = before.followed_by(gpdf, found, self._recheck)
        if self._gripper is None:
            return history
        loaded = with_loads(gpdf, history.grasps, self._gripper, self._mass)
        return replace(history, grasps=loaded)

    def _calc(self, context: Context) -> GraspSet:
        history: GraspHistory = self._now.Eval(context)
        return GraspSet.empty({"object not seen": 1}) if history.gpdf is None else history.grasps
