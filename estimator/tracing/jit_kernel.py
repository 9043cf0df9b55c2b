"""Compilation of plain Python functions together with the functions they call.

Functions are written once, in plain Python, beside their equations. `entry` compiles such a function, and
the functions of this package that it calls by name. If numba cannot compile one as it is (because it
distinguishes arrays from numbers), a twin for one number at a time stands in `COMPILED`.

Names of compiled functions become symbols of machine code, and machine code from disk is linked by
symbol: of two symbols with the same name the first is used. So every name contains a digest of all that
its machine code depends on. numba's own counter is not enough: it starts anew in each process.

Import it inside functions only, or from other kernels: numba takes half a second to load.
"""

from __future__ import annotations

import dis
from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeVar, cast

from numba import njit

from icreckon.estimator.base import choices
from icreckon.estimator.tracing.elementary import LIBRARY
from icreckon.estimator.tracing.kernel_cache import KernelCache, environment_digest

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILED: dict[Any, Any] = {}
# A function that only compiled code calls needs no wrapper for Python, which takes time to compile.
INNER: dict[str, Any] = {
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def compiled(function: Function) -> Function:
    """Compile a function for Python and for other kernels, with a disk cache."""
    twin = _renamed(function, function.__globals__, "")
    return cast(Function, _cached(twin, {"error_model": "numpy"}))


def jit(function: Callable[..., Any]) -> Any:
    """Compile a function that other compiled ones call.

    Raises:
        ValueError: it calls itself, directly or through others.
    """
    return _jit(function, ())


def inner(shape_digest: str) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function that is defined for each shape and called by compiled ones.

    Args:
        shape_digest: digest of the shape.
    """
    return lambda function: njit(**INNER)(_with_compiled_callees(function, shape_digest))


def entry(function: Callable[..., Any], shape_digest: str = "") -> Any:
    """Compile a function, and those that it calls, for Python, with a disk cache.

    The machine code releases the interpreter's lock while it runs.

    Args:
        function: the function.
        shape_digest: digest of the shape, if the function is defined anew for each shape.

    Raises:
        ValueError: the function has variables of an enclosing function, and no digest of them; or a
            function that it calls calls itself.
    """
    if function.__code__.co_freevars and not shape_digest:
        raise ValueError(
            f"{function.__qualname__} uses variables of the function around it and needs a digest of them"
        )
    return _cached(
        _with_compiled_callees(function, shape_digest), {"error_model": "numpy", "nogil": True}
    )


def _cached(function: FunctionType, options: dict[str, Any]) -> Any:
    dispatcher = njit(**options)(function)
    package = function.__module__.split(".")[1]
    dispatcher._cache = KernelCache(f"{function.__module__}.{function.__qualname__}", package)
    return dispatcher


def _jit(function: Any, callers: tuple[Any, ...]) -> Any:
    if function in callers:
        raise ValueError(f"{function.__qualname__} calls itself, which compiled functions cannot")
    if function not in COMPILED:
        COMPILED[function] = njit(**INNER)(_with_compiled_callees(function, "", callers))
    return COMPILED[function]


def _with_compiled_callees(
    function: Any, shape_digest: str, callers: tuple[Any, ...] = ()
) -> FunctionType:
    names = dict(function.__globals__)
    for name in _loaded_globals(function):
        callee = names.get(name)
        if isinstance(callee, FunctionType) and callee.__module__.startswith(LIBRARY):
            names[name] = _jit(callee, (*callers, function))
    return _renamed(function, names, shape_digest)


def _loaded_globals(function: Any) -> list[str]:
    """Names that a function loads as globals; an attribute may be named like one."""
    loads = dis.get_instructions(function.__code__)
    return list(dict.fromkeys(one.argval for one in loads if one.opname == "LOAD_GLOBAL"))


def _renamed(function: Any, names: dict[str, Any], shape_digest: str) -> FunctionType:
    """Copy a function; its name contains digests of all inputs of the compiler."""
    twin = FunctionType(
        function.__code__, names, function.__name__, function.__defaults__, function.__closure__
    )
    digest = environment_digest(function.__module__.split(".")[1])
    twin.__module__ = function.__module__
    name = function.__qualname__.replace("<locals>.", "")
    twin.__qualname__ = ".".join(filter(None, (name, shape_digest, digest)))
    return twin


def _holds(condition: bool) -> bool:
    return condition


COMPILED[choices.every] = COMPILED[choices.some] = jit(_holds)
