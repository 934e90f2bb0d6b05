"""Joint-space controller over IK solutions of the grasps."""

from feasigrasp.models.choices import ControlSpace
from feasigrasp.systems.horizon_controller import HorizonController


class GPJointController(HorizonController):
    """Plans down a Gaussian-process distance field over the grasps' configurations.

    See `feasigrasp.models.control.horizon.distance`.
    """

    space = ControlSpace.JOINT
