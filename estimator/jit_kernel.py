"""One source for plain Python and for numba: functions compiled together with those that they call.

Functions are written once, in plain Python, where the equations belong. `jit` compiles such a function;
what it calls by name from this package is compiled too. What numba cannot do in the plain way (tell an
array from a number) has a twin here for one number at a time.

Import it inside functions only, or from other kernels: numba takes half a second to load.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FunctionType
from typing import Any

from numba import njit

from estimator import motion_model

COMPILED: dict[Any, Any] = {}
# The digest in the name of a file that numba keeps.
KEPT_NAME = re.compile(r"\.([0-9a-f]{12})-\d+\.py")
# What only compiled code calls needs no way in from Python, which takes time to make.
INNER: dict[str, Any] = {
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def jit(function: Callable[..., Any]) -> Any:
    """A function for other compiled ones to call."""
    if function not in COMPILED:
        COMPILED[function] = njit(**INNER)(_with_compiled_callees(function, {}))
    return COMPILED[function]


def entry(
    function: Callable[..., Any], made: str = "", callees: dict[str, Any] | None = None
) -> Any:
    """A compiled function for Python to call; what it was compiled to is kept beside the source.

    numba keeps it until the file of the function itself changes. So its name there says what all the
    files of this package hold, those of the functions that it calls among them. It lets go of the
    interpreter while it works.

    Args:
        function: the function.
        made: tells apart those that are made of one function with different `callees`.
        callees: name -> what takes its place in the function.
    """
    twin = _with_compiled_callees(function, callees or {})
    twin.__qualname__ = f"{function.__qualname__}{made}.{_sources()}"
    _forget_others(Path(function.__code__.co_filename).parent)
    try:
        return njit(cache=True, error_model="numpy", nogil=True)(twin)
    except RuntimeError:  # there is no place to keep it
        return njit(error_model="numpy", nogil=True)(twin)


def _with_compiled_callees(function: Any, callees: dict[str, Any]) -> FunctionType:
    names = dict(function.__globals__) | callees
    for name in function.__code__.co_names:
        callee = names.get(name)
        if isinstance(callee, FunctionType) and callee.__module__.startswith("estimator."):
            if callees:
                names[name] = njit(**INNER)(_with_compiled_callees(callee, callees))
            else:
                names[name] = jit(callee)
    twin = FunctionType(function.__code__, names, function.__name__, function.__defaults__)
    twin.__module__ = function.__module__
    return twin


def _sources() -> str:
    """A digest of the files of this package."""
    if not _DIGEST:
        digest = hashlib.sha256()
        for path in sorted(Path(__file__).parent.rglob("*.py")):
            digest.update(path.read_bytes())
        _DIGEST.append(digest.hexdigest()[:12])
    return _DIGEST[0]


def _forget_others(folder: Path) -> None:
    """Take away what was compiled in a folder of files that have changed since."""
    if folder in _TIDIED:
        return
    _TIDIED.add(folder)
    for path in folder.glob("__pycache__/*.nb[ic]"):
        of_sources = KEPT_NAME.search(path.name)
        if of_sources is not None and of_sources.group(1) != _sources():
            with suppress(OSError):
                path.unlink()


_DIGEST: list[str] = []
_TIDIED: set[Path] = set()


def _holds(condition: bool) -> bool:
    return condition


COMPILED[motion_model.every] = COMPILED[motion_model.some] = njit(**INNER)(_holds)
