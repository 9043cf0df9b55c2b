"""Warnings on missing inputs: topics without messages, joints in no message."""

from collections.abc import Iterable, Mapping, Sequence

from icreckon.estimator.base.errors import nearest_hint

MOST_NAMES = 8  # most topics that a warning lists


def silent_topic(
    purpose: str,
    topic: str,
    fitting: Iterable[str],
    available: Mapping[str, Sequence[str]],
    waited: float,
) -> str:
    """Warning on a topic that has no publisher, or a publisher without messages."""
    if topic in available:
        return (
            f"{purpose}: {topic} has a publisher, and no message has come for {waited:.0f} s: does the "
            "driver run, and is input_reliability:=best_effort needed?"
        )
    types = set(fitting)
    others = sorted(name for name, offered in available.items() if types & set(offered))
    if not others:
        offer = f"there is none of type {' or '.join(sorted(types))}" if types else ""
    else:
        more = f" and {len(others) - MOST_NAMES} more" if len(others) > MOST_NAMES else ""
        offer = f"of a fitting type there is {', '.join(others[:MOST_NAMES])}{more}"
    return (
        f"{purpose}: nobody has published {topic} for {waited:.0f} s{'; ' if offer else ''}{offer}; name "
        f"the topic in [log.{purpose}] of the robot file"
    )


def missing_joints(topic: str, wanted: Iterable[str], seen: Iterable[str]) -> str:
    """Warning on mapped joints that are in no message; empty if each is in one."""
    joints = sorted(seen)
    missing = [name for name in wanted if name not in joints]
    if not missing:
        return ""
    hints = {name: nearest_hint(name, joints) for name in missing}
    if len(missing) == 1:
        return f"joint {missing[0]!r} of [log.tracks] has not come on {topic}{hints[missing[0]]}"
    names = ", ".join(map(repr, missing))
    has = ", ".join(map(repr, joints[:MOST_NAMES])) + (", ..." if len(joints) > MOST_NAMES else "")
    return f"joints {names} of [log.tracks] have not come on {topic}, which has {has}"
