"""Errors for users: one line each, with the value found and what to do."""

# Compiled code reads and writes by index without bounds checks, so each entry compares sizes first. It
# cannot format text.
WRONG_SIZE = (
    "compiled code was given an array of the wrong size and has not touched it; this is a defect of "
    "icreckon, please report it with the whole traceback"
)


class IcreckonError(Exception):
    """Base of every error that icreckon raises on purpose; its text is for the user."""


class EstimatorError(IcreckonError):
    """Bad robot file, bad parameters or an invalid measurement."""


class SettingError(EstimatorError, ValueError):
    """Invalid value in settings or in a robot file.

    It is a ValueError, too, so that msgspec, which reads files into these structures, reports its place
    in the file.
    """


def nearest_hint(found: str, allowed: list[str]) -> str:
    """Clause of a message: `; did you mean 'x'?`, or the list of the allowed names."""
    import difflib

    names = {name.lower(): name for name in allowed}
    close = difflib.get_close_matches(found.lower(), names, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {names[close[0]]!r}?"
    return f"; there is {', '.join(repr(name) for name in sorted(allowed))}"


class BatchError(EstimatorError):
    """Runs or filters that cannot run as lanes of a batch."""
