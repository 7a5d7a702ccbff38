"""Where compiled kernels are kept, and under which key: one that changes with the source of any kernel.

Numba's own cache identifies a function only by the file that defines it, although the functions that it calls are
compiled into it: after a change of a function in another file it would still load the old code. Here the folder's name
contains a fingerprint of the sources of all kernels.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import platform
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl, FunctionCache

from mapmend.datasets.cache import user_folder

PACKAGE = Path(__file__).parent
PREFIX = "kernels-"
KEPT_FOLDERS, KEPT_S = 4, 3600.0
"""Folders of other fingerprints stay while they are among the latest four, or were used within the last hour."""


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """Compiles a function at its first call, without the interpreter's lock, and keeps the code for later processes.

    ``options`` are those of `numba.njit`, such as ``inline="always"``.
    """
    if function is None:
        return functools.partial(kernel, **options)
    dispatcher = numba.njit(nogil=True, **options)(function)
    # What Numba does for ``cache=True``, with the cache below; there is no public way to choose it for one package.
    if cache_folder() is not None:
        dispatcher._cache = _KernelCache(function)
    return dispatcher


@functools.cache
def fingerprint() -> str:
    """The fingerprint of the sources of all kernels and the versions of Python and Numba, 16 hexadecimal digits."""
    content = hashlib.sha256(f"{platform.python_version()} {numba.__version__}".encode())
    for path in kernel_files():
        source = path.read_bytes()
        content.update(f"\n{path.relative_to(PACKAGE).as_posix()} {len(source)}\n".encode() + source)
    return content.hexdigest()[:16]


def kernel_files() -> list[Path]:
    """The files with kernels, and with types in their signatures, in order."""
    folders = (Path(folder) for folder, _, _ in os.walk(PACKAGE) if not folder.endswith("__pycache__"))
    return sorted(path for folder in folders for path in folder.glob("_*kernel*.py"))


@functools.cache
def cache_folder() -> Path | None:
    """The folder of this fingerprint, made if it is missing, or None if no place can be written.

    Places, first to last: ``NUMBA_CACHE_DIR``, the package's ``__pycache__``, the user's folder for caches. When a new
    folder is made, old ones are removed.
    """
    for place in _places():
        folder = place / f"{PREFIX}{fingerprint()}"
        try:
            is_new = not folder.is_dir()
            folder.mkdir(parents=True, exist_ok=True)
            # This marks the folder as used, and fails, as it should, if the folder is read-only.
            (folder / "used").touch()
        except OSError:
            continue
        if is_new:
            _remove_old(place)
        return folder
    return None


def _places() -> list[Path]:
    if numba.config.CACHE_DIR:
        return [Path(numba.config.CACHE_DIR) / "mapmend"]
    places = [PACKAGE / "__pycache__"]
    with contextlib.suppress(RuntimeError):
        places.append(user_folder())
    return places


def _remove_old(place: Path) -> None:
    """Removes the folders of other versions, except the latest and those that may still be in use."""
    used_s = {}
    for folder in place.glob(f"{PREFIX}*"):
        try:
            used_s[folder] = (folder / "used").stat().st_mtime
        except OSError:  # another process makes or removes it
            continue
    latest = sorted(used_s, key=lambda folder: used_s[folder], reverse=True)
    for folder in latest[KEPT_FOLDERS:]:
        if used_s[folder] < time.time() - KEPT_S:
            shutil.rmtree(folder, ignore_errors=True)


class _Locator:
    """Numba's interface for the place of one function in the cache."""

    def __init__(self, function: Callable[..., Any]) -> None:
        self._py_file = function.__code__.co_filename
        self._line = function.__code__.co_firstlineno

    def ensure_cache_path(self) -> None:
        os.makedirs(self.get_cache_path(), exist_ok=True)

    def get_cache_path(self) -> str:
        return str(cache_folder())

    def get_source_stamp(self) -> str:
        """The folder holds the code of one state of the sources only."""
        return fingerprint()

    def get_disambiguator(self) -> str:
        return str(self._line)


class _KernelCacheImpl(CompileResultCacheImpl):
    def __init__(self, function: Callable[..., Any]) -> None:
        # Instead of Numba's own, which finds a place for each file.
        self._lineno = function.__code__.co_firstlineno
        self._locator = _Locator(function)
        name = f"{function.__module__}.{function.__qualname__}"
        self._filename_base = self.get_filename_base(name, getattr(sys, "abiflags", ""))


class _KernelCache(FunctionCache):
    _impl_class = _KernelCacheImpl
