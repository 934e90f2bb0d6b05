"""The errors a user can act on; every message names the value, the limit and the mend."""

from collections.abc import Iterator
from contextlib import contextmanager

#: Large packages that parts of the library work without; they may be left out of an environment.
LARGE_PACKAGES = ("torch", "open3d")


class FeasigraspError(Exception):
    """Base class of the project's own errors."""


class ArgumentError(FeasigraspError, ValueError):
    """An argument of a wrong type, shape or range."""


class PointCloudError(FeasigraspError, ValueError):
    """A point cloud that no distance field can be fitted to (too few points, NaN, wrong shape)."""


class CameraError(FeasigraspError, ValueError):
    """A depth image, camera or sensor noise that cannot be worked with (wrong shape or range)."""


class MeshError(FeasigraspError, ValueError):
    """A mesh that cannot become a rigid object (missing, not watertight, wrong scale)."""


class ScenarioError(FeasigraspError, ValueError):
    """A scenario file or name that does not describe something runnable."""


class GraspError(FeasigraspError, ValueError):
    """A set of grasps or a gripper description with inconsistent content."""


class ReachabilityError(FeasigraspError, ValueError):
    """An arm or a file that no reachable space can be made from."""


class InputError(FeasigraspError, ValueError):
    """A file that cannot be read (missing, cut off, of another kind)."""


class OutputError(FeasigraspError, OSError):
    """A file that cannot be written (a folder of its name, no right to, a full disk)."""


class ControlError(FeasigraspError, ValueError):
    """Options of a controller that contradict each other or the arm."""


class HardwareError(FeasigraspError, RuntimeError):
    """A driver that is silent or has stopped, or a message bus that cannot be opened."""


class WorkerError(FeasigraspError, RuntimeError):
    """A process of ours that does not start, has died, or hangs."""


class MissingPackageError(FeasigraspError, ImportError):
    """One of `LARGE_PACKAGES` is needed and not installed."""


@contextmanager
def needed_by(what: str) -> Iterator[None]:
    """Around an import, for ``what``, of one of `LARGE_PACKAGES`, or of what imports one.

    Raises:
        MissingPackageError: It is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        if package not in LARGE_PACKAGES:
            raise
        raise MissingPackageError(
            f"{what} needs {package}, which is not installed; run 'pip install {package}'"
        ) from error
