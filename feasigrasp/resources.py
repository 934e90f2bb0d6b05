"""Where model and diagram files live: beside the package in a wheel, at the root in a checkout."""

from pathlib import Path

from feasigrasp.errors import FeasigraspError

_PACKAGE = Path(__file__).resolve().parent


class ResourceError(FeasigraspError, FileNotFoundError):
    """A file that is not part of this installation."""


def model_path(*parts: str) -> Path:
    """The absolute path of a file or folder in ``models/``, e.g. ``"objects", "mug.obj"``.

    A wheel carries it as ``feasigrasp/_models``; in a checkout (editable installation or
    ``PYTHONPATH``) it is ``models/`` at the repository root.

    Raises:
        ResourceError: If there is no ``models/`` folder, or nothing of that name in it.
    """
    return _find("models", parts)


def diagram_path(*parts: str) -> Path:
    """The same of ``diagrams/``, which is ``feasigrasp/_diagrams`` in a wheel."""
    return _find("diagrams", parts)


def _find(folder: str, parts: tuple[str, ...]) -> Path:
    places = (_PACKAGE / f"_{folder}", _PACKAGE.parent / folder)
    root = next((place for place in places if place.is_dir()), None)
    if root is None:
        raise ResourceError(
            f"The {folder}/ folder is neither at {places[0]} (wheel) nor at {places[1]} "
            "(checkout); reinstall feasigrasp, or run it from a complete checkout."
        )
    path = root.joinpath(*parts)
    if not path.exists():
        siblings = sorted(p.name for p in path.parent.iterdir()) if path.parent.is_dir() else []
        raise ResourceError(
            f"{Path(*parts)} is not in {root}; "
            f"{path.parent.name}/ holds: {', '.join(siblings) or 'nothing'}."
        )
    return path
