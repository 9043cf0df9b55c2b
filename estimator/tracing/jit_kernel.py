"""One source for plain Python and for numba: functions compiled together with those that they call.

Functions are written once, in plain Python, where the equations belong. `entry` compiles such a function;
what it calls by name from this package is compiled too. What numba cannot do in the plain way (tell an
array from a number) has a twin here for one number at a time.

Names of compiled functions become symbols of machine code, and machine code that is loaded from disk is
linked by symbol: of two symbols with one name the first counts. So every name holds a digest of all that
its machine code depends on. numba's own counter does not tell them apart, it starts anew in each process.

Import it inside functions only, or from other kernels: numba takes half a second to load.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any, TypeVar, cast

from numba import njit

from icreckon.estimator.base import choices
from icreckon.estimator.tracing.kernel_cache import KernelCache, environment_digest
from icreckon.estimator.tracing.trace import LIBRARY

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILED: dict[Any, Any] = {}
# What only compiled code calls needs no way in from Python, which takes time to make.
INNER: dict[str, Any] = {
    "error_model": "numpy",
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


def compiled(function: Function) -> Function:
    """Compile a function for Python and for other kernels to call; keep its machine code on disk."""
    twin = _renamed(function, function.__globals__, "")
    return cast(Function, _kept(twin, {"error_model": "numpy"}))


def jit(function: Callable[..., Any]) -> Any:
    """Compile a function for other compiled ones to call."""
    if function not in COMPILED:
        COMPILED[function] = njit(**INNER)(_with_compiled_callees(function, ""))
    return COMPILED[function]


def inner(made: str) -> Callable[[Callable[..., Any]], Any]:
    """Compile a function that is defined anew for each shape, for other compiled ones to call.

    Args:
        made: digest of the shape.
    """
    return lambda function: njit(**INNER)(_with_compiled_callees(function, made))


def entry(function: Callable[..., Any], made: str = "") -> Any:
    """Compile a function and all that it calls for Python to call; keep its machine code on disk.

    The machine code lets go of the interpreter while it works.

    Args:
        function: the function.
        made: digest of the shape, of a function that is defined anew for each.

    Raises:
        ValueError: the function has variables of an enclosing function, and no digest of them.
    """
    if function.__code__.co_freevars and not made:
        raise ValueError(
            f"{function.__qualname__} uses variables of the function around it and needs a digest of them"
        )
    return _kept(_with_compiled_callees(function, made), {"error_model": "numpy", "nogil": True})


def _kept(function: FunctionType, options: dict[str, Any]) -> Any:
    dispatcher = njit(**options)(function)
    package = function.__module__.split(".")[1]
    dispatcher._cache = KernelCache(f"{function.__module__}.{function.__qualname__}", package)
    return dispatcher


def _with_compiled_callees(function: Any, made: str) -> FunctionType:
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        callee = names.get(name)
        if isinstance(callee, FunctionType) and callee.__module__.startswith(LIBRARY):
            names[name] = jit(callee)
    return _renamed(function, names, made)


def _renamed(function: Any, names: dict[str, Any], made: str) -> FunctionType:
    """Copy a function under a name that holds the digests of all that its machine code depends on."""
    twin = FunctionType(
        function.__code__, names, function.__name__, function.__defaults__, function.__closure__
    )
    digest = environment_digest(function.__module__.split(".")[1])
    twin.__module__ = function.__module__
    name = function.__qualname__.replace("<locals>.", "")
    twin.__qualname__ = ".".join(filter(None, (name, made, digest)))
    return twin


def _holds(condition: bool) -> bool:
    return condition


COMPILED[choices.every] = COMPILED[choices.some] = jit(_holds)
