"""Compiler: functions of numbers become machine code, for one filter or for many lanes.

`trace` records what a function does with its numbers, `emit` writes that as vector code, `jit_kernel`
compiles with numba, `kernel_cache` keeps machine code on disk. It knows no filter. Below: `base`.
"""
