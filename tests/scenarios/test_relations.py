"""Files of relations."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from scenarios.logs.relations import read_relations
from scenarios.types import SourceError
from tests.scenarios.laser_logs import write

STAMPS = 1000.0 + 0.5 * np.arange(100)

TEXT = """# timestamp1 timestamp2 x y z roll pitch yaw
1000.000000 1000.5 0.1 -0.2 0.7 0.01 0.02 0.3
1001.000000 1049.5 1.1 -1.2 0.0 0.0 0.0 -3.0

1002.000000 1005.0 2.1 -2.2 0.0 0.0 0.0 3.5
"""


@pytest.mark.parametrize("pack", [False, True])
def test_relations(tmp_path: Path, pack: bool) -> None:
    path = tmp_path / "some.relations"
    path.write_bytes(gzip.compress(TEXT.encode()) if pack else TEXT.encode())
    found = read_relations(path, STAMPS)
    np.testing.assert_array_equal(found.times, [[1000.0, 1000.5], [1001.0, 1049.5], [1002.0, 1005.0]])
    np.testing.assert_array_equal(found.poses, [[0.1, -0.2, 0.3], [1.1, -1.2, -3.0], [2.1, -2.2, 3.5]])
    assert found.warnings == ()


def test_a_last_line_cut_short_is_a_warning(tmp_path: Path) -> None:
    found = read_relations(write(tmp_path, TEXT + "1003.0 1004.0 0.1"), STAMPS)
    assert len(found.times) == 3
    assert "some.log:6: the last line" in found.warnings[0]


@pytest.mark.parametrize("wrong", ["1001.0 x 0 0 0 0 0 0", "1001.0 1002.0 0 0 0", "1001.0 1002.0 0 0 0 0 0 nan"])
def test_a_broken_line_is_named(tmp_path: Path, wrong: str) -> None:
    lines = TEXT.splitlines()
    with pytest.raises(SourceError, match=r"some\.log:3: .*expected 8 columns: first stamp"):
        read_relations(write(tmp_path, "\n".join([*lines[:2], wrong, *lines[3:]]) + "\n"), STAMPS)


def test_relations_beyond_the_log_are_no_complaint(tmp_path: Path) -> None:
    more = "".join(f"{2000 + k}.0 {2001 + k}.0 0 0 0 0 0 0\n" for k in range(50))
    assert len(read_relations(write(tmp_path, TEXT + more), STAMPS).times) == 53


@pytest.mark.parametrize(("shift", "belong"), [(500.0, "none"), (0.2, "none"), (0.0, "3")])
def test_relations_of_another_log(tmp_path: Path, shift: float, belong: str) -> None:
    """Of another time, or of this one but with scans that are not in the log."""
    others = "".join(f"{1010.13 + k:.2f} {1011.13 + k:.2f} 0 0 0 0 0 0\n" for k in range(4))
    path = write(tmp_path, TEXT + others)
    message = rf"some\.log: {belong} of its 7 relations belong to the log: they are from 1000\.000 s to 1049\.500 s"
    with pytest.raises(SourceError, match=message) as caught:
        read_relations(path, STAMPS + shift)
    assert "\n" not in str(caught.value)
