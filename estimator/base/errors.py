"""The errors that users are meant to see: one line each, with what was found and what to do."""


class IcreckonError(Exception):
    """Base of every error that icreckon raises on purpose; its text is meant for the user."""


class EstimatorError(IcreckonError):
    """Bad robot file, bad parameters or a measurement that the estimator cannot take."""


class SettingError(EstimatorError, ValueError):
    """A figure or a choice that a structure of settings or of the robot file cannot take.

    A ValueError too, so that msgspec, which reads files into these structures, says where in the file.
    """


def nearest_hint(found: str, allowed: list[str]) -> str:
    """A «did you mean» clause for a misspelt name.

    Args:
        found: the name as it was written.
        allowed: the names that exist.

    Returns:
        `; did you mean 'x'?` when something is close, otherwise the list of what is allowed.
    """
    import difflib

    names = {name.lower(): name for name in allowed}
    close = difflib.get_close_matches(found.lower(), names, n=1, cutoff=0.5)
    if close:
        return f"; did you mean {names[close[0]]!r}?"
    return f"; there is {', '.join(repr(name) for name in sorted(allowed))}"


class BatchError(EstimatorError):
    """Runs or filters that cannot be worked through side by side."""
