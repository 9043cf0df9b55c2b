"""Compilation of plain Python functions together with the functions they call.

Functions are written once, in plain Python, next to their equations. `entry` compiles such a function
and the functions of this package that it calls by name. If numba cannot compile one as it is (because it
distinguishes arrays from numbers), a twin for one number at a time stands in `COMPILED`.

Names of compiled functions become symbols of machine code, and machine code from disk is linked by
symbol: of two symbols with the same name the first is used. So every name contains a digest of all that
its machine code depends on. numba's own counter is not enough: it starts again in each process.

Import it inside functions only, or from other kernels: numba takes half a second to load.
"""

import dis
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any, TypeVar, cast

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

from icreckon.estimator.base import choices
from icreckon.estimator.tracing.elementary import LIBRARY
from icreckon.estimator.tracing.kernel import call_kernel
from icreckon.estimator.tracing.kernel_cache import KernelCache, environment_digest

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILED: dict[Any, Any] = {}
# A function that only compiled code calls needs no wrapper for Python, which takes time to compile.
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def compiled(function: Function) -> Function:
    """Compile a function for Python and for other kernels, with a disk cache."""
    twin = _renamed(function, function.__globals__)
    return cast(Function, _cached(twin, {"error_model": "numpy"}))


@cache
def entry(function: Callable[..., Any]) -> Any:
    """Compile a function, and those that it calls, for Python, with a disk cache.

    The machine code releases the interpreter's lock while it runs.

    Raises:
        ValueError: the function has variables of an enclosing function, which its name does not show;
            or a function that it calls calls itself.
    """
    if function.__code__.co_freevars:
        raise ValueError(f"{function.__qualname__} uses variables of the function around it")
    return _cached(_with_compiled_callees(function, ()), {"error_model": "numpy", "nogil": True})


def direct_entry(function: Callable[..., Any]) -> Any:
    """Machine code of a function that was called before; otherwise as `entry`.

    numba looks at the types of all arguments in each call, which takes 0.5 µs. The machine code assumes
    them: arguments must be of the same types, and arrays contiguous, as in the calls before.
    """
    dispatcher = entry(function)
    overloads = list(dispatcher.overloads.values())
    return overloads[0].entry_point if len(overloads) == 1 else dispatcher


def _cached(function: FunctionType, options: dict[str, Any]) -> Any:
    """Compile with numba's options, and the disk cache of the function's package."""
    dispatcher = njit(**options)(function)
    package = function.__module__.split(".")[1]
    dispatcher._cache = KernelCache(f"{function.__module__}.{function.__qualname__}", package)
    return dispatcher


def jit(function: Any, callers: tuple[Any, ...] = ()) -> Any:
    """Compile a function that compiled ones call; `ValueError` if it calls itself."""
    if function in callers:
        raise ValueError(f"{function.__qualname__} calls itself, which compiled functions cannot")
    if function not in COMPILED:
        inner_njit = njit(error_model="numpy", **INNER)
        dispatcher: Any = inner_njit(_with_compiled_callees(function, callers))
        template = dispatcher.get_call_template
        # numba would compile a function again for each constant that it is called with.
        dispatcher.get_call_template = lambda args, kw: template([*map(types.unliteral, args)], kw)
        COMPILED[function] = dispatcher
    return COMPILED[function]


def _with_compiled_callees(function: Any, callers: tuple[Any, ...]) -> FunctionType:
    """Copy a function; functions of this package that it calls are compiled ones."""
    names = dict(function.__globals__)
    # Names that it loads as globals; an attribute may be named like one.
    loads = (load for load in dis.get_instructions(function) if load.opname == "LOAD_GLOBAL")
    for name in dict.fromkeys(load.argval for load in loads):
        callee = names.get(name)
        if isinstance(callee, FunctionType) and callee.__module__.startswith(LIBRARY):
            names[name] = jit(callee, (*callers, function))
    return _renamed(function, names)


def _renamed(function: Any, names: dict[str, Any]) -> FunctionType:
    """Copy a function; its name contains a digest of all inputs of the compiler."""
    twin = FunctionType(
        function.__code__, names, function.__name__, function.__defaults__, function.__closure__
    )
    digest = environment_digest(function.__module__.split(".")[1])
    twin.__module__ = function.__module__
    twin.__qualname__ = f"{function.__qualname__.replace('<locals>.', '')}.{digest}"
    return twin


def _holds(condition: bool) -> bool:
    """Twin of `choices.every` and `choices.some` for one number at a time."""
    return condition


@intrinsic
def _call_at(_typing_context: Any, kernel: Any, lanes: Any, inputs: Any, constants: Any) -> Any:
    """Twin of `call_kernel` for an address."""
    del kernel

    def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        arrays = zip(signature.args[1:], args[1:], strict=True)
        data = [context.make_array(kind)(context, builder, array).data for kind, array in arrays]
        function = ir.FunctionType(ir.IntType(64), [pointer] * len(data)).as_pointer()
        pointers = [builder.bitcast(one, pointer) for one in data]
        return builder.call(builder.inttoptr(args[0], function), pointers)

    return types.int64(types.int64, lanes, inputs, constants), code


COMPILED[call_kernel] = _call_at
COMPILED[choices.every] = COMPILED[choices.some] = jit(_holds)
