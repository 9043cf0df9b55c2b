"""Compiler of functions of numbers, for one filter or for many lanes.

In: functions in plain Python. Out: machine code. `trace` records the operations of a function, `emit`
writes them as vector code, `jit_kernel` compiles with numba, `kernel_cache` saves machine code on disk.
The room contains no filter. Below: `base`.
"""
