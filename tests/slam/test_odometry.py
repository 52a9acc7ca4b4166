"""Scan matching in place of odometry: what becomes of the frame that filters get."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios.noise import add_noise
from scenarios.registry import build
from slam.geometry import compose, invert, wrap_all
from slam.motion import Matched, Odometry, deviation, propagate
from slam.perception.matching import Match, Matcher, Track
from slam.perception.odometry import NOWHERE, Increment, correct_odometry, increment, then
from slam.types import Floats, Frame, Noise, Params

STEPS = 50


@pytest.fixture(scope="module")
def frames() -> tuple[list[Frame], Floats]:
    """A drive round a corner, as the robot reports it, and where it truly was (STEPS + 1, 3)."""
    source = build("loop", start=2.0)
    rng = np.random.default_rng(3)
    noisy = [add_noise(rng, step.frame, source.noise) for step in source.steps[:STEPS]]
    return noisy, np.array([source.start, *(step.truth for step in source.steps[:STEPS])])


def followed(frames: list[Frame], params: Params, start: Floats) -> tuple[Floats, list[Frame], list]:
    track, pose, poses, corrected, matches = None, start, [start], [], []
    for frame in frames:
        track, new, match = correct_odometry(track, frame, params)
        for u, dt in zip(new.u, new.dt, strict=True):
            pose = np.array(propagate(new.motion, pose, u, dt)[0])
        poses.append(pose)
        corrected.append(new)
        matches.append(match)
    return np.array(poses), corrected, matches


def off(poses: Floats, truth: Floats) -> float:
    """[rad] root mean square of the heading: along a corridor no scan shows where the robot is."""
    return float(np.sqrt(np.mean(wrap_all(poses[:, 2] - truth[:, 2]) ** 2)))


def test_it_is_nearer_to_the_truth_than_odometry(frames: tuple[list[Frame], Floats]) -> None:
    noisy, truth = frames
    by_odometry, same, none = followed(noisy, Params(believed=Noise(range=0.01)), truth[0])
    assert all(a is b for a, b in zip(same, noisy, strict=True))
    assert none == [None] * STEPS
    for how in ("auto", "on"):
        matched, corrected, matches = followed(noisy, Params(matching=how, believed=Noise(range=0.01)), truth[0])
        assert off(matched, truth) < 0.3 * off(by_odometry, truth)
        assert sum(match.used for match in matches) > 0.9 * STEPS
        used = [frame for frame, match in zip(corrected, matches, strict=True) if match.used]
        assert all(isinstance(frame.motion, Matched) and frame.u.shape == (1, 3) for frame in used)


def test_the_covariance_is_that_of_the_errors_or_more(frames: tuple[list[Frame], Floats]) -> None:
    """It covers errors that scans have in common, so beside noise alone it is large; and never more than odometry's."""
    noisy, truth = frames
    params = Params(matching="on", believed=Noise(range=0.01))
    _, corrected, matches = followed(noisy, params, truth[0])
    for k, (frame, match) in enumerate(zip(corrected, matches, strict=True)):
        if match.used:
            s, _, H_u = propagate(frame.motion, (0.0, 0.0, 0.0), frame.u[0], 1.0)
            half = np.array(H_u) * deviation(frame.motion, frame.u, params.believed)[0]
            np.testing.assert_allclose(half @ half.T, match.covariance, atol=1e-12)
            np.testing.assert_allclose(s, match.u, atol=1e-12)
            error = match.u - compose(invert(truth[k]), truth[k + 1])
            assert error @ np.linalg.solve(match.covariance + 1e-12 * np.eye(3), error) < 20.0
            before = increment(noisy[k], params).covariance
            assert np.linalg.eigvalsh(before - match.covariance + 1e-8 * np.eye(3)).min() > -1e-6


def test_without_a_scan_nothing_changes(frames: tuple[list[Frame], Floats]) -> None:
    frame = frames[0][0]._replace(scan=None)
    assert correct_odometry(None, frame, Params(matching="on")) == (None, frame, None)


def test_a_very_good_odometry_is_left_alone_unless_somebody_wants_it(frames: tuple[list[Frame], Floats]) -> None:
    frame, u = frames[0][0], np.array([[0.5, 0.0, 0.0]])
    frame = frame._replace(motion=Odometry(0.1, 1.0, 1.0, 0.0, True), u=u, dt=np.ones(1))
    for odometry, how, leaves in ((0.07, "auto", True), (0.07, "on", False), (0.08, "auto", False)):
        params = Params(matching=how, believed=Noise(range=0.01, odometry=odometry))
        track, same, match = correct_odometry(None, frame, params)
        assert (same is frame and track is None and match is None) == leaves


def test_what_is_not_matched_is_odometry(frames: tuple[list[Frame], Floats]) -> None:
    noisy, _ = frames
    params = Params(matching="on")
    track, first, match = correct_odometry(None, noisy[0], params)
    assert first is noisy[0]
    assert match is not None
    assert not match.used
    assert match.reason
    assert noisy[1].scan is not None
    blind = noisy[1]._replace(scan=noisy[1].scan._replace(ranges=np.full_like(noisy[1].scan.ranges, np.inf)))
    after, same, match = correct_odometry(track, blind, params)
    assert same is blind
    assert match is not None
    assert (match.used, match.u.tolist()) == (False, increment(blind, params).u.tolist())
    assert after is not None


def test_scans_on_the_way_are_matched_one_after_the_other(frames: tuple[list[Frame], Floats]) -> None:
    """Two frames as one, with the scan of the first on the way, end where the two do."""
    noisy, _ = frames
    params = Params(matching="on", believed=Noise(range=0.01))
    track, *_ = correct_odometry(None, noisy[0], params)
    one, _, first = correct_odometry(track, noisy[1], params)
    _, _, second = correct_odometry(one, noisy[2], params)
    a, b = noisy[1], noisy[2]
    assert a.scan is not None
    both = b._replace(u=np.concatenate([a.u, b.u]), dt=np.concatenate([a.dt, b.dt]), between=(a.scan,))
    _, frame, found = correct_odometry(track, both, params)
    assert first is not None
    assert second is not None
    assert found is not None
    expected = then(Increment(first.u, first.covariance), Increment(second.u, second.covariance))
    np.testing.assert_allclose(found.u, expected.u, atol=1e-12)
    np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-12)
    assert (found.overlap, found.residual) == (
        min(first.overlap, second.overlap),
        max(first.residual, second.residual),
    )
    assert frame.dt.sum() == pytest.approx(both.dt.sum())
    alone = []  # where it is not known which scan is whose, there is one way, for the last of them
    for between in ((), (a.scan, a.scan)):
        _, lumped, match = correct_odometry(track, both._replace(between=between), params)
        assert lumped.u.shape == (1, 3)
        assert match is not None
        alone.append(match.u.tolist())
    assert alone[0] == alone[1] != found.u.tolist()


def test_a_way_of_which_a_part_is_matched(frames: tuple[list[Frame], Floats]) -> None:
    """The rest of it is odometry's; it does not count as matched, but is better than odometry all the same."""
    noisy, _ = frames
    params = Params(matching="on", believed=Noise(range=0.01))
    track, *_ = correct_odometry(None, noisy[0], params)
    a, b = noisy[1], noisy[2]
    assert a.scan is not None
    assert b.scan is not None
    blind = a.scan._replace(ranges=np.full_like(a.scan.ranges, np.inf))
    u, dt = np.concatenate([a.u, b.u]), np.concatenate([a.dt, b.dt])
    for between, last, seen in ((a.scan, blind, 0), (blind, b.scan, 1)):
        both = b._replace(u=u, dt=dt, between=(between,), scan=last)
        after, frame, found = correct_odometry(track, both, params)
        assert found is not None
        assert (found.used, found.reason, found.overlap) == (False, "too few points", 0.0)
        assert isinstance(frame.motion, Matched)
        assert frame.dt.tolist() == [pytest.approx(both.dt.sum())]
        assert after is not None
        odometry = [increment(both, params, k, k + 1) for k in range(2)]
        if seen == 0:  # the first half as that scan alone has it, and then what odometry says
            _, _, alone = correct_odometry(track, a, params)
            assert alone is not None
            assert alone.used
            expected = then(Increment(alone.u, alone.covariance), odometry[1])
            np.testing.assert_allclose(found.u, expected.u, atol=1e-12)
            np.testing.assert_allclose(found.covariance, expected.covariance, atol=1e-12)
        assert np.trace(found.covariance) < np.trace(then(*odometry).covariance)
        np.testing.assert_allclose(propagate(frame.motion, (0.0, 0.0, 0.0), frame.u[0], 0.0)[0], found.u, atol=1e-12)


def test_the_ticks_of_a_frame_amount_to_its_motion(frames: tuple[list[Frame], Floats]) -> None:
    """As a whole, or as some of them and then the others; no tick is no motion."""
    noisy, params = frames[0], Params(believed=Noise(odometry=0.2))
    many = noisy[0]._replace(
        u=np.concatenate([f.u for f in noisy[20:32]]), dt=np.concatenate([f.dt for f in noisy[20:32]])
    )
    whole, parts = increment(many, params), then(increment(many, params, 0, 5), increment(many, params, 5))
    s = np.zeros(3)
    for u in many.u:
        s = compose(s, u)
    np.testing.assert_allclose(whole.u, s, atol=1e-12)
    np.testing.assert_allclose(parts.u, whole.u, atol=1e-12)
    np.testing.assert_allclose(parts.covariance, whole.covariance, atol=1e-12)
    assert np.linalg.eigvalsh(whole.covariance).min() > 0.0
    none = increment(many, params, 3, 3)
    np.testing.assert_array_equal(none.u, 0.0)
    np.testing.assert_array_equal(none.covariance, 0.0)


def test_a_frame_without_ticks_may_have_a_scan(frames: tuple[list[Frame], Floats]) -> None:
    """As the first of a log: the robot has not moved, and the scan fits where it was."""
    noisy, params = frames[0], Params(matching="on")
    still = noisy[0]._replace(u=np.zeros((0, 3)), dt=np.zeros(0))
    track, frame, first = correct_odometry(None, still, params)
    assert first is not None
    assert frame is still
    assert (first.used, first.u.tolist()) == (False, [0.0, 0.0, 0.0])
    _, frame, again = correct_odometry(track, still, params)
    assert again is not None
    assert again.used
    assert (frame.u.shape, frame.dt.tolist()) == ((1, 3), [0.0])
    np.testing.assert_allclose(again.u, 0.0, atol=1e-3)
    np.testing.assert_allclose(again.covariance, 0.0, atol=1e-7)  # the odometry of a robot at rest is exact


@pytest.mark.parametrize("how", ["off", "auto"])
def test_what_was_tracked_is_forgotten_where_nothing_is_matched(frames: tuple[list[Frame], Floats], how: str) -> None:
    noisy, _ = frames
    track, *_ = correct_odometry(None, noisy[0], Params(matching="on"))
    assert track is not None
    frame = noisy[1] if how == "off" else noisy[1]._replace(scan=None)
    assert correct_odometry(track, frame, Params(matching=how)) == (None, frame, None)


def test_whoever_switches_matching_on_has_it_whatever_odometry_says(
    frames: tuple[list[Frame], Floats], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    def told(track: Track, scan: object, u: Floats, Q: Floats, settings: Matcher) -> tuple[Track, Match]:
        asked.append(settings)
        return track, Match(u, Q, 1.0, 0.0, True, "")

    monkeypatch.setattr("slam.perception.odometry.match_scan", told)
    for how in ("auto", "on"):
        correct_odometry(None, frames[0][0], Params(matching=how), Matcher(clean=0.5))
    assert asked == [Matcher(clean=0.5), Matcher(clean=0.5, surprise=np.inf)]


def test_errors_of_one_motion_after_another() -> None:
    """Against draws: within four standard errors of their covariance."""
    rng = np.random.default_rng(5)
    half = [np.diag([0.02, 0.01, 0.03]) @ rng.normal(size=(3, 3)) for _ in range(2)]
    one, other = (Increment(u, h @ h.T) for u, h in zip(([0.4, 0.1, 0.7], [0.3, -0.2, -2.9]), half, strict=True))
    N = 200_000
    a, b = (np.asarray(i.u) + rng.normal(size=(N, 3)) @ h.T for i, h in zip((one, other), half, strict=True))
    both = then(Increment(np.array(one.u), one.covariance), Increment(np.array(other.u), other.covariance))
    drawn = compose(a, b) - both.u
    drawn[:, 2] = wrap_all(drawn[:, 2])
    size = np.sqrt(np.diag(both.covariance))
    np.testing.assert_allclose(
        np.cov(drawn.T) / np.outer(size, size), both.covariance / np.outer(size, size), atol=0.03
    )
    assert then(NOWHERE, one).covariance == pytest.approx(one.covariance)


def test_odometry_that_walks() -> None:
    """Its variance after a way is the same in one increment as in many; that in proportion is not."""
    u = np.array([[0.4, 0.0, 0.1]])
    many = np.repeat(u / 4, 4, axis=0)
    for walk in (True, False):
        motion = Odometry(0.2, 0.5, 0.7, 0.3, walk)
        one = deviation(motion, u, Noise(odometry=0.3))
        four = deviation(motion, many, Noise(odometry=0.3))
        assert np.allclose(one**2, (four**2).sum(axis=0)) == walk
    np.testing.assert_allclose(
        deviation(Odometry(0.2, 0.5, 0.7, 0.3, True), u, Noise(odometry=0.3))[0] ** 2 / 0.09,
        [0.4 + 0.09 * 0.1, 0.49 * 0.4 + 0.09 * 0.1, 0.04 * 0.4 + 0.25 * 0.1],
    )
