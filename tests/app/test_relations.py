"""What judges the paths of a session by relations: which paths, between which scans."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from app import session
from app.errors import UsageError
from app.paths import MATCHED, ODOMETRY, Paths
from app.relations import PathErrors, relations_of
from app.sources import LogParts, load
from app.types import SessionInfo, SessionStep
from scenarios.registry import build
from scenarios.types import SourceError
from slam.estimators import ESTIMATORS
from tests.app.drive import Drive
from tests.app.test_recording import Watch


@pytest.fixture(scope="module")
def info(drive: Drive) -> SessionInfo:
    source = load(str(drive.log), {}, LogParts(first=5))
    return session.make_info(source, [ESTIMATORS["dfs"]], source.params(particles=5, matching="auto"))


@pytest.fixture(scope="module")
def steps(info: SessionInfo) -> list[SessionStep]:
    watch = Watch()
    session.run(info, [watch])
    return watch.steps


def judge(drive: Drive, info: SessionInfo) -> PathErrors:
    found = PathErrors(relations_of(drive.relations, info.source))
    found.begin(info)
    return found


def test_paths_are_judged_whenever_somebody_asks(drive: Drive, info: SessionInfo, steps: list[SessionStep]) -> None:
    """Between scan 5, where this part of the log begins, and the scan of the last step so far."""
    errors = judge(drive, info)
    assert errors.found() == {}
    assert info.source.scans is not None
    kept, counts = info.source.scans.kept, set()
    for step in steps:
        errors.step(step)
        found = errors.found()
        assert set(found) == {ODOMETRY, MATCHED, "dfs"}
        inside = [i >= 5 and k <= kept[step.index - 1] for i, k in drive.pairs]
        assert {(e.used, e.left_out) for e in found.values()} == {(sum(inside), 4 - sum(inside))}
        counts.add(sum(inside))
    assert counts == {0, 1, 2, 3}  # the relation from scan 0 is never one
    paths = Paths()
    paths.begin(info)
    for step in steps:
        paths.step(step)
    so_far = {key: path for key, (_, path) in paths.found().items()}
    np.testing.assert_allclose(so_far[ODOMETRY], drive.odometry[5 : 5 + len(so_far[ODOMETRY])], atol=1e-5)
    for key, path in so_far.items():
        off = drive.off(np.concatenate([np.zeros((5, 3)), path]))[1:]
        translation = errors.found()[key].translation_m
        assert translation is not None
        assert (translation.mean, translation.max) == pytest.approx((off.mean(), off.max()), abs=1e-4)


def test_matching_is_judged_only_if_it_was_on_all_the_time(
    drive: Drive, info: SessionInfo, steps: list[SessionStep]
) -> None:
    for off in ([2], range(1, info.steps + 1)):
        errors = judge(drive, info)
        for step in steps:
            errors.step(dataclasses.replace(step, matched=None) if step.index in off else step)
        assert set(errors.found()) == {ODOMETRY, "dfs"}


def test_relations_are_for_logs_of_a_laser(drive: Drive, info: SessionInfo, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--relations does not apply to loop: it is for logs of a laser"):
        relations_of(drive.relations, build("loop"))
    with pytest.raises(SourceError, match=r"no\.relations: cannot be read"):
        relations_of(tmp_path / "no.relations", info.source)
