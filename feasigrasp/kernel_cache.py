"""Deletes stale numba caches after an edit or an upgrade, before a kernel is loaded.

Numba keeps what it compiled beside the source and compiles it anew when that file has changed. It
does not notice that a function of *another* file has, which it inlined or whose constants it froze:
after ``git pull`` or ``pip install -U``, arms would go on obeying the old code in silence. So a
record of all sources lies with the cache, and what depends on a changed one, through whatever
imports, is deleted.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from numba.misc.appdirs import AppDirs

PACKAGE = Path(__file__).parent
_RECORD = "feasigrasp-sources.json"


def forget_stale(package: Path = PACKAGE) -> list[str]:
    """Deletes cached kernels of the sources that are others than when they were compiled.

    Args:
        package: Folder of the package; those beside it whose name begins with its name, such as
            ``feasigrasp_lab``, are looked through as well.

    Returns:
        Sources whose kernels were deleted, relative to the folder that holds the package. Without
        a place to write to numba keeps nothing either, and nothing is done.
    """
    record = _record_file(package)
    if record is None:
        return []
    root = package.parent
    now = {
        str(file.relative_to(root)): hashlib.sha256(file.read_bytes()).hexdigest()
        for folder in sorted(root.glob(f"{package.name}*"))
        for file in sorted(folder.rglob("*.py"))
    }
    try:
        before = dict(json.loads(record.read_text()))
    except (OSError, ValueError):
        before = {}
    if before == now:
        return []
    changed = {name for name in now if now[name] != before.get(name)}
    stale = sorted(_dependants(root, set(now), changed | (before.keys() - now.keys())))
    for name in stale:
        for file in _cached(root / name):
            file.unlink(missing_ok=True)
    with suppress(OSError):  # a full disk: the same is found, and deleted, next time
        unfinished = record.with_suffix(f".{os.getpid()}")
        unfinished.write_text(json.dumps(now))
        unfinished.replace(record)
    return stale


def _record_file(package: Path) -> Path | None:
    for folder in _folders(package):
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK):
                return folder / _RECORD
    return None


def _folders(package: Path) -> Iterator[Path]:
    """Where numba keeps caches, in the order in which it tries."""
    if chosen := os.environ.get("NUMBA_CACHE_DIR"):
        yield Path(chosen)
        if os.access(chosen, os.W_OK):
            return  # numba looks no further
    yield package / "__pycache__"
    yield Path(AppDirs(appname="numba", appauthor=False).user_cache_dir)


def _cached(source: Path) -> Iterator[Path]:
    """Caches of a source; those of its namesakes too, where numba has a folder for all."""
    pattern = f"{source.stem}.*.nb[ic]"
    for folder in _folders(source.parent):
        yield from (*folder.glob(pattern), *folder.glob(f"*/{pattern}"))


def _dependants(root: Path, names: set[str], changed: set[str]) -> set[str]:
    """The sources that import changed ones, directly or not, and these."""
    users: dict[str, set[str]] = {}
    for name in names:
        for imported in _imports(root, name):
            users.setdefault(imported, set()).add(name)
    found, to_do = set[str](), list(changed)
    while to_do:
        name = to_do.pop()
        if name not in found:
            found.add(name)
            to_do += users.get(name, ())
    return found & names


def _imports(root: Path, name: str) -> Iterator[str]:
    """Files that a source may import, relative to the folder that holds its package."""
    for node in ast.walk(ast.parse((root / name).read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            modules = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Import):
            modules = [alias.name for alias in node.names]
        else:
            continue
        for module in modules:
            path = module.replace(".", "/")
            yield from (f"{path}.py", f"{path}/__init__.py")
