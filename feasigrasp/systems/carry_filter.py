"""Grasps are rated by how likely the object stays in the hand as it is."""

from __future__ import annotations

import numpy as np
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from feasigrasp.models.grasps.carry import rated
from feasigrasp.models.grasps.grasp_set import GraspSet
from feasigrasp.systems.ports import declare_input, declare_output

#: Direction of gravity in W.
_DOWN = np.array([0.0, 0.0, -1.0])


class CarryFilter(LeafSystem):
    """How likely the pads of grasps bear the object's weight as the object is turned now.

    .. pydrake_system::

        name: CarryFilter
        input_ports:
        - grasps
        - object_pose
        output_ports:
        - grasps

    ``grasps`` are in the object frame O, before and after; ``object_pose`` X_WO is a
    ``RigidTransform``; while it is not finite, the worst direction of gravity counts, and nothing
    is dropped. Scores are multiplied by the probability that a grasp carries (`rated`); how sure is
    enough depends on what is in reach, which `GripperSequencer` knows. What hardly carries is
    dropped and counted as "too heavy there". Grasps whose `GraspSet.load` nobody has told pass as
    they are.
    """

    def __init__(self) -> None:
        """A filter; what it judges by comes with the grasps."""
        super().__init__()
        self._grasps = declare_input(self, "grasps", GraspSet.empty())
        self._pose = declare_input(self, "object_pose", RigidTransform())
        declare_output(self, "grasps", self._calc, {self._grasps.ticket(), self._pose.ticket()})

    def _calc(self, context: Context) -> GraspSet:
        R_WO = self._pose.Eval(context).rotation().matrix()
        down = _DOWN @ R_WO if np.isfinite(R_WO).all() else None
        return rated(self._grasps.Eval(context), down)
