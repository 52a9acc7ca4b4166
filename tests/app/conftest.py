"""What several tests of `app` begin with."""

from __future__ import annotations

import pytest

from tests.app.drive import Drive


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return Drive(tmp_path_factory.mktemp("drive"))
