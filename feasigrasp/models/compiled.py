"""The numba decorator: cached, deterministic, independent of the first caller.

Numba compiles a function anew when its own file has changed. It misses changes of *another* file,
whose functions it inlined or whose constants it froze. So the stamp of a cached function is here a
hash of its source and of all that this one imports of its package, directly or not.

Where an option is left out, numba takes ``fastmath``, ``error_model`` and ``forceinline`` from the
function that happens to be compiled when this one is called for the first time; what the cache then
holds, and with it the last bits of every result, depends on the order of calls. So all three are
said here.

``fastmath`` leaves the last bits to the compiler. A function that is called by another one is in
the machine code of both, and which of the two copies runs depends on which was loaded first. So
what is relaxed is called by Python alone or inlined (``forceinline``) up to what is;
tests/models/test_compiled.py watches over it. `fused` is for the rest.
"""

import hashlib
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from numba import njit, types
from numba.core.caching import FunctionCache, IndexDataCacheFile
from numba.extending import intrinsic


def compiled(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Decorator of functions to compile: ``@compiled``, or with options of ``numba.njit``.

    Division by zero gives infinity or NaN, as in NumPy.
    """
    ours: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": False}
    # No function's address is taken: that is 6 % of the time to compile.
    ours |= {"forceinline": False, "no_cfunc_wrapper": True, **options}

    def decorated(of: Callable[..., Any]) -> Any:
        try:
            dispatcher: Any = njit(**ours)(of)
        except RuntimeError:  # no folder can be written to: every process compiles it
            return njit(**(ours | {"cache": False}))(of)
        if isinstance(cache := dispatcher._cache, FunctionCache):
            stamp = sources_hash(Path(of.__code__.co_filename), of.__module__)
            cache._cache_file = _Index(cache.cache_path, cache._impl.filename_base, stamp)
        return dispatcher

    return decorated if function is None else decorated(function)


class _Index(IndexDataCacheFile):
    """Cache files of a function; damaged ones, or of types that are gone, are compiled anew.

    Its hash stands behind the machine code: changed code would run, or end the process.
    """

    def save(self, key: Any, data: Any) -> None:
        with suppress(OSError):  # a full disk, or a folder in its place: the next process compiles
            super().save(key, data)

    def _load_index(self) -> dict[Any, str]:
        try:
            found = super()._load_index()
        except Exception:
            return {}
        return found if isinstance(found, dict) else {}

    def _load_data(self, name: str) -> Any:
        data = Path(self._data_path(name)).read_bytes()
        size = hashlib.sha256().digest_size
        if hashlib.sha256(data[:-size]).digest() != data[-size:]:
            raise FileNotFoundError(f"{name} is damaged")  # numba compiles then
        try:
            return super()._load_data(name)
        except Exception as error:
            raise FileNotFoundError(f"{name} cannot be read") from error

    def _dump(self, obj: Any) -> bytes:
        code: bytes = super()._dump(obj)
        return code + hashlib.sha256(code).digest()


#: What a module imports: ``from THIS import THESE`` or ``import THIS``.
_IMPORT = re.compile(
    r"^\s*(?:from\s+([\w.]+)\s+import\s+(\([^)]*\)|.*)|import\s+([\w.]+))", re.MULTILINE
)


@cache
def sources_hash(file: Path, module: str) -> str:
    """Hash of the source file of a module, and of all that it imports of its package.

    Packages whose names begin alike, such as ``feasigrasp`` and ``feasigrasp_lab``, count as one.
    """
    root, package = file.parents[module.count(".")], re.split(r"[._]", module)[0]
    found, to_do = dict[Path, bytes](), [file]
    while to_do:
        if (each := to_do.pop()) not in found:
            found[each], imported = _source(each, root, package)
            to_do += imported
    parts = (f"{each.relative_to(root)} {found[each].hex()}" for each in sorted(found))
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()


@cache
def _source(file: Path, root: Path, package: str) -> tuple[bytes, tuple[Path, ...]]:
    """Hash of a source, and the sources of its package that it imports."""
    text = file.read_bytes()
    names = list[str]()
    for origin, imported, alone in _IMPORT.findall(text.decode()):
        if (name := origin or alone).startswith(package):
            names += [name, *(f"{name}.{word}" for word in re.findall(r"\w+", imported))]
    paths = (root / name.replace(".", "/") for name in names)
    files = (f for path in paths for f in (path.with_suffix(".py"), path / "__init__.py"))
    return hashlib.sha256(text).digest(), tuple(f for f in files if f.is_file())


# Multiply and add with one rounding. ``fastmath={"contract"}`` lets the compiler fuse wherever it
# likes: two copies of a function then differ in the last bit. Written out, it is the same anywhere.
def _fused(typing_context: Any, a: Any, b: Any, c: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), generate


#: ``fused(a, b, c)`` is ``a b + c`` of floats, rounded once, in compiled code.
fused: Any = intrinsic(_fused)
