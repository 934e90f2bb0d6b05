"""Grasps of the object that a distance field describes."""

from __future__ import annotations

from pydrake.common.value import AbstractValue, Value
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.grasps import GraspSamplerFn, GraspSet


class GraspSampler(LeafSystem):
    """Samples and filters grasps, once per distance field.

    .. pydrake_system::

        name: GraspSampler
        input_ports:
        - gpdf
        output_ports:
        - grasps

    ``gpdf`` is a `Gpdf` or None (nothing seen yet), ``grasps`` a `GraspSet` in the same frame, with
    the reason and count of every rejection; empty if nothing was seen. Any callable from a field to
    a grasp set can be the sampler.
    """

    def __init__(self, sampler: GraspSamplerFn) -> None:
        """A system around one sampler, e.g. `AntipodalSampler`."""
        super().__init__()
        self._sampler = sampler
        self._gpdf = self.DeclareAbstractInputPort("gpdf", Value[object](None))
        self.DeclareAbstractOutputPort(
            "grasps",
            lambda: AbstractValue.Make(GraspSet.empty()),
            self._calc,
            {self._gpdf.ticket()},
        )

    def _calc(self, context: Context, output) -> None:  # type: ignore[no-untyped-def]
        gpdf = self._gpdf.Eval(context)
        grasps = GraspSet.empty({"object not seen": 1}) if gpdf is None else self._sampler(gpdf)
        output.set_value(grasps)
