"""Grasps of the object that a distance field describes."""

from __future__ import annotations

from functools import partial

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, LeafSystem, ValueProducer

from feasigrasp.models.grasps.grasp_set import GraspSamplerFn, GraspSet
from feasigrasp.models.grasps.matching import GraspHistory, recheck_grasps
from feasigrasp.models.robot.gripper import ParallelGripper


class GraspSampler(LeafSystem):
    """Samples and filters grasps, once per distance field, and knows them again on the next one.

    .. pydrake_system::

        name: GraspSampler
        input_ports:
        - gpdf
        output_ports:
        - grasps

    ``gpdf`` is a `Gpdf` or None (nothing seen yet), ``grasps`` a `GraspSet` in the same frame, with
    the reason and count of every rejection; empty if nothing was seen. Any callable from a field to
    a grasp set can be the sampler.

    Grasps keep their ``id`` from field to field, and their pose as long as they pass the filter on
    the new one. The output is a function of the field and of the state, which is the history up to
    the field before; it is brought up to date every ``period`` seconds, so fields may not change
    more often than that.
    """

    def __init__(
        self,
        sampler: GraspSamplerFn,
        gripper: ParallelGripper | None = None,
        *,
        period: float = 0.05,
    ) -> None:
        """A system around one sampler, e.g. `AntipodalSampler`.

        Args:
            sampler: From a field to its grasps.
            gripper: The hand that grasps of earlier fields are checked with; without it they are
                not kept, and new grasps beside them have their ids.
            period: Time between updates of the history [s].
        """
        super().__init__()
        self._sampler = sampler
        self._recheck = None if gripper is None else partial(recheck_grasps, gripper=gripper)
        self._gpdf = self.DeclareAbstractInputPort("gpdf", Value[object](None))
        before = AbstractValue.Make(GraspHistory())
        self._before = self.DeclareAbstractState(before)
        self._now = self.DeclareCacheEntry(
            "grasps of the present field",
            ValueProducer(before.Clone, self._calc_history),
            {self._gpdf.ticket(), self.abstract_state_ticket(self._before)},
        )
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._remember)
        self.DeclareAbstractOutputPort(
            "grasps",
            lambda: AbstractValue.Make(GraspSet.empty()),
            self._calc,
            {self._now.ticket()},
        )

    def _calc_history(self, context: Context, output) -> None:
        before: GraspHistory = context.get_abstract_state(int(self._before)).get_value()
        gpdf = self._gpdf.Eval(context)
        if gpdf is not None and gpdf is not before.gpdf:
            before = before.followed_by(gpdf, self._sampler(gpdf), self._recheck)
        output.set_value(before)

    def _remember(self, context: Context, state) -> None:
        state.get_mutable_abstract_state(int(self._before)).set_value(self._now.Eval(context))

    def _calc(self, context: Context, output) -> None:
        history: GraspHistory = self._now.Eval(context)
        seen = history.gpdf is not None
        output.set_value(history.grasps if seen else GraspSet.empty({"object not seen": 1}))
