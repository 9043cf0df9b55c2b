"""Dead reckoning for tracked and skid-steer robots whose ICRs move with inertia.

The public names of the estimator, the simulator and the replay module stand in `__init__.pyi`, which type
checkers read, too. Each name is imported when first used.
"""

import logging
from importlib import import_module
from typing import Any

# Public name -> its module, and its name there. A line is `from MODULE import NAME as PUBLIC`.
with open(f"{__path__[0]}/__init__.pyi", encoding="utf-8") as _stub:  # pathlib takes long to import
    _LINES = [line.split() for line in _stub if line.startswith("from ")]
_HOMES = {words[5]: (words[1], words[3]) for words in _LINES}

__all__ = sorted(_HOMES)  # noqa: PLE0605 - the stub is the one list of names
__version__ = "0.3.0"
# A program decides where the records of `icreckon` and the loggers below it go.
logging.getLogger(__name__).addHandler(logging.NullHandler())


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'icreckon' has no attribute {name!r}")
    home, original = _HOMES[name]
    module = import_module(home)
    value = (
        getattr(module, original)
        if hasattr(module, original)
        else import_module(f"{home}.{original}")
    )
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
