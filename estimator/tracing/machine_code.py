"""Machine code of kernels, which compiled functions call by address.

So a function around kernels is compiled once, not again for each filter shape. Each kernel has a file on
disk.

Import it inside functions only, or from other kernels: numba takes half a second to load.
"""

import hashlib
from collections.abc import Callable, Hashable
from functools import cache
from typing import Any

from numba.core.codegen import JITCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target

from icreckon.estimator.tracing.emit import emit
from icreckon.estimator.tracing.kernel import Kernel
from icreckon.estimator.tracing.kernel_cache import DIGITS, CodeFiles, environment_digest

LIBRARIES: list[Any] = []  # code in memory, which must stay as long as its addresses are used


class KernelLibrary(JITCodeLibrary):
    """Library of numba without LLVM's passes, by which traced numbers gain nothing."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout

    def _optimize_final_module(self) -> None:
        pass


@cache
def address_of(
    make: Callable[..., Kernel], arguments: tuple[Hashable, ...], width: int, bits: int = 64
) -> int:
    """Address of a kernel's machine code, which is compiled or loaded from disk.

    `make` makes the kernel from arguments whose `repr` shows all that it depends on, for `width` lanes of
    numbers of 64 or 32 `bits`.
    """
    described = repr((make.__module__, make.__qualname__, arguments, width, bits))
    digest = hashlib.sha256(described.encode()).hexdigest()[:DIGITS]
    symbol = f"{make.__name__}.{digest}.{environment_digest('estimator')}"
    codegen = cpu_target.target_context.codegen()
    files = CodeFiles("estimator")
    key = symbol, str(codegen.magic_tuple())
    with global_compiler_lock:
        saved = files.load(symbol, key)
        if saved is not None:
            return _loaded(codegen.unserialize_library(saved), symbol)
        # There is one graph of traced numbers at a time.
        library = compiled_library(make(*arguments), symbol, width, bits)
        files.save(symbol, key, library.serialize_using_object_code())
        return _loaded(library, symbol)


def compiled_library(kernel: Kernel, symbol: str, width: int, bits: int = 64) -> Any:
    """Compile a kernel as a function of this name, in a library of numba."""
    with global_compiler_lock:
        codegen = cpu_target.target_context.codegen()
        library: Any = KernelLibrary(codegen, symbol)  # type: ignore[no-untyped-call]
        library.enable_object_caching()
        module = library.create_ir_module(symbol)
        emit(module, symbol, kernel, width, bits)
        library.add_ir_module(module)
        library.finalize()
    return library


def _loaded(library: Any, symbol: str) -> int:
    LIBRARIES.append(library)
    address: int = library.get_pointer_to_function(symbol)
    assert address, symbol  # noqa: S101 - a call of it would end the process
    return address
