"""Where real logs are found."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The directory of real logs: beside the repository, or where DUALSLAM_DATA says.

    A bare clone has none, and tests that need one skip; on CI (CI=true) they must be there.
    """
    place = Path(os.environ.get("DUALSLAM_DATA") or ROOT.parent / "shared" / "data")
    if place.is_dir():
        return place
    reason = f"no real logs in {place}; set DUALSLAM_DATA to the directory that holds mrclam and victoria-park"
    if os.environ.get("CI", "").lower() == "true":
        pytest.fail(f"{reason}; on CI they are required")
    pytest.skip(reason)
