"""Data of results: types of JSON alone, flat tables, and the versions of packages."""

from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import msgspec


def json_types(data: Any) -> dict[str, Any]:
    """Convert to JSON types: None for NaN and infinity, lists for tuples and arrays."""
    encoded = msgspec.json.encode(data, enc_hook=lambda array: array.tolist())
    return msgspec.json.decode(encoded, type=dict[str, Any])


def flatten(data: dict[str, Any], table: str = "") -> dict[str, Any]:
    """Flatten nested tables to dotted keys, as "vehicle.mass", in their order."""
    flat: dict[str, Any] = {}
    for key, value in data.items():
        path = f"{table}.{key}" if table else key
        flat |= flatten(value, path) if isinstance(value, dict) else {path: value}
    return flat


def package_versions(names: Iterable[str]) -> dict[str, str]:
    """Installed versions of packages, "not installed" for others."""
    versions = {}
    for name in names:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "not installed"
    return versions
