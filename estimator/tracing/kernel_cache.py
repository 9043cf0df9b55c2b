"""Machine code on disk, one file for each signature; safe for many processes.

numba's own cache has an index for each function. If two processes save different signatures at the same
time, an index entry may lead to the other's machine code. Here the name of a file depends on all that its
machine code depends on. A file contains its key and a checksum, and is moved into place whole.

Import it inside functions only, or from kernels: numba takes half a second to load.
"""

import hashlib
import os
import pickle
import sys
import warnings
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import config
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.misc.appdirs import AppDirs

from icreckon.estimator.base.files import write_whole

CHECKSUM = hashlib.sha256
CHECKSUM_BYTES = CHECKSUM().digest_size
# Options of numba that change the machine code.
OPTIONS = ("OPT", "LOOP_VECTORIZE", "SLP_VECTORIZE", "BOUNDSCHECK")
PACKAGES = ("estimator", "simulation")  # packages with compiled code
DIGITS = 16  # digits of a digest in names of symbols, files and folders


class CodeFiles:
    """Files of machine code of a package: pickled data with a key and a checksum."""

    def __init__(self, package: str) -> None:
        self.folder = cache_folder() / environment_digest(package)

    def load(self, name: str, key: tuple[str, ...]) -> Any:
        """Load the data of a name and a key; None if no whole file has them."""
        try:
            content = self._path(name, key).read_bytes()
        except OSError:
            return None
        checksum, payload = content[:CHECKSUM_BYTES], content[CHECKSUM_BYTES:]
        if CHECKSUM(payload).digest() != checksum:
            return None
        saved_key, data = pickle.loads(payload)  # noqa: S301 - our own file, like numba's cache
        return data if saved_key == key else None

    def save(self, name: str, key: tuple[str, ...], data: Any) -> None:
        """Save data; warn once in a process if the folder cannot be written."""
        payload: bytes = dumps((key, data))  # type: ignore[no-untyped-call]
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            write_whole(self._path(name, key), CHECKSUM(payload).digest() + payload)
        except OSError as error:
            _warn_once(str(cache_folder()), error.strerror or "no room")

    def _path(self, name: str, key: tuple[str, ...]) -> Path:
        return self.folder / f"{name}-{CHECKSUM(repr(key).encode()).hexdigest()[:DIGITS]}.kernel"


class KernelCache(NullCache):
    """Disk cache of a named compiled function, with the interface of numba's own."""

    def __init__(self, name: str, package: str) -> None:
        self._name, self._files = name, CodeFiles(package)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the machine code of a signature; None if there is none."""
        target_context.refresh()
        reduced = self._files.load(self._name, self._key(sig, target_context.codegen()))
        if reduced is None:
            return None
        return CompileResult._rebuild(target_context, *reduced)  # type: ignore[no-untyped-call]

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save the machine code of a signature."""
        if all(lifted.can_cache for lifted in data.lifted) and not data.library.has_dynamic_globals:
            self._files.save(self._name, self._key(sig, data.codegen), data._reduce())

    def _key(self, sig: Any, codegen: Any) -> tuple[str, str, str]:
        return self._name, str(sig), str(codegen.magic_tuple())


def cache_folder() -> Path:
    """Folder of compiled functions: $NUMBA_CACHE_DIR/icreckon, or the user's cache."""
    chosen = os.environ.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen) / "icreckon"
    folder = Path(AppDirs("icreckon", appauthor=False).user_cache_dir)  # type: ignore[no-untyped-call]
    # A user without a home gets a place that cannot be written.
    return (folder if folder.is_absolute() else Path(os.devnull)) / "kernels"


def kernel_files() -> list[Path]:
    """Files of compiled functions of this version of the code and of the compiler."""
    folders = {cache_folder() / environment_digest(package) for package in PACKAGES}
    return [path for folder in folders for path in folder.glob("*.kernel") if path.is_file()]


def why_not_kept() -> str:
    """Try to write to the cache folder; return why that fails, empty if it works."""
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        write_whole(cache_folder() / "writable", b"")
    except OSError as error:
        return error.strerror or "no room"
    return ""


def warn_unless_kept() -> None:
    """Warn once if the cache folder cannot be written; workers do not warn."""
    if reason := why_not_kept():
        _warn_once(str(cache_folder()), reason)


@cache
def environment_digest(package: str) -> str:
    """Digest of the sources and versions that machine code of a package depends on."""
    digest = hashlib.sha256()
    versions = sys.implementation.cache_tag, *(one.__version__ for one in (numba, llvmlite, np))
    options = [getattr(config, name) for name in OPTIONS]
    digest.update(repr((versions, options)).encode())
    for folder in sorted({"estimator", package}):
        root = Path(__file__).parents[2] / folder
        for path in sorted(root.rglob("*.py")):
            digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:DIGITS]


@cache
def _warn_once(folder: str, reason: str) -> None:
    """Warn once in a command that compiled functions cannot be saved."""
    if parent_process() is not None:
        return
    warnings.warn(
        f"compiled functions cannot be kept in {folder} ({reason}), so they are compiled again in each "
        "process; set NUMBA_CACHE_DIR to a folder that can be written",
        RuntimeWarning,
        stacklevel=2,
    )
