"""Which version of the program this is."""

from __future__ import annotations

from importlib import metadata


def version() -> str:
    """As it was installed."""
    try:
        return metadata.version("dual-fastslam-workbench")
    except metadata.PackageNotFoundError:  # run from a copy that was never installed
        return "unknown"
