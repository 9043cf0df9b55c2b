"""Public names: what functions return is among them, and `dir` shows nothing else."""

import inspect
from collections.abc import Iterator
from typing import Any, get_args, get_type_hints

import icreckon

INTERNAL = {"FrictionTruth", "KinematicTruth"}
"""Classes that only the simulator's own code uses."""


def classes_in(hint: Any) -> Iterator[type]:
    if isinstance(hint, type) and hint.__module__.startswith("icreckon"):
        yield hint
    for part in get_args(hint):
        yield from classes_in(part)


def functions_of(public: Any) -> Iterator[Any]:
    """A function itself, or the public methods and properties of a class."""
    if inspect.isfunction(public):
        yield public
    elif inspect.isclass(public):
        for name, one in vars(public).items():
            one = one.fget if isinstance(one, property) else getattr(one, "__func__", one)
            if inspect.isfunction(one) and not name.startswith("_"):
                yield one


def test_what_public_functions_return_is_public() -> None:
    every = [getattr(icreckon, name) for name in icreckon.__all__]
    public = {one for one in every if inspect.isclass(one)}
    missing = {
        f"{found.__module__}.{found.__qualname__}"
        for one in every
        for function in functions_of(one)
        for found in classes_in(get_type_hints(function).get("return"))
        if found not in public and found.__name__ not in INTERNAL
    }
    # A measurement is any of the public kinds, or one that was registered.
    assert not {name for name in missing if not name.endswith(".Measurement")}


def test_dir_shows_the_public_names_alone() -> None:
    assert dir(icreckon) == sorted({*icreckon.__all__, "__version__"})
