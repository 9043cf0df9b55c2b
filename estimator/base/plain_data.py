"""Data of results: types of JSON alone, and the versions of packages."""

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import msgspec


def json_types(data: Any) -> Any:
    """Convert to JSON types: None for NaN and infinity, lists for tuples and arrays."""
    return msgspec.json.decode(msgspec.json.encode(data, enc_hook=lambda array: array.tolist()))


def package_versions(names: Iterable[str]) -> dict[str, str]:
    """Installed versions of packages, "not installed" for others."""
    versions = {}
    for name in names:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions
