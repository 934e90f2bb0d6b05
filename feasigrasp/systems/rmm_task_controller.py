"""Task-space controller over a Riemannian mixture of grasps."""

from feasigrasp.models.choices import ControlSpace
from feasigrasp.systems.horizon_controller import HorizonController


class RMMTaskController(HorizonController):
    """Plans down the negative log density of a Riemannian mixture over the grasps.

    See `feasigrasp.models.control.horizon.density`.
    """

    space = ControlSpace.TASK
