"""Two walls of a map that are one: when they are merged, what comes of it, and that nobody sees what is gone."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from slam.association import associate
from slam.estimators import ESTIMATORS
from slam.features import Wall, distance, united
from slam.features.wall import CORNER, EDGE, LEVER, SAME_END
from slam.geometry import wrap
from slam.map_store import MapStore
from slam.metrics import measure
from slam.motion import Odometry
from slam.phases import extend_features, initial, merge_features, noise_of_known, observation_noise
from slam.presets import LOG
from slam.types import IGNORED, NEW, UNKNOWN_TAG, Floats, Frame, Ints, Noise, Params, Particles

WALL = Wall()
PARAMS = Params(particles=1, believed=Noise(odometry=0.1), merge_walls=True)
ORIGIN = np.zeros(3)
FILTERS = ["dfs", "fs2", "fs1"]


def along_x(begin: float, end: float, y: float, angle: float = 0.0, ends: tuple[float, float] = (0.0, 0.0)) -> Floats:
    """(8,) a wall below the robot, that is on its left, from x = begin to x = end."""
    return np.array([0.5 * (begin + end), y, angle, 0.5 * (begin - end), 0.5 * (end - begin), *ends, 2.0])


def seen_along_x(begin: float, end: float, y: float, ends: tuple[int, int] = (0, 0), angle: float = 0.0) -> Floats:
    """(11,) the same as a piece, from the origin."""
    return np.array(
        [0.5 * (begin + end), y, angle, 0.5 * (begin - end), 0.5 * (end - begin), 1e-6, 1e-6, *ends, 20, angle]
    )


def frame_of(*pieces: Floats) -> Frame:
    z = np.array(pieces).reshape(-1, 11)
    tags = np.full(len(z), UNKNOWN_TAG)
    return Frame(1.0, Odometry(), np.zeros((1, 3)), np.ones(1), WALL, z, tags)


def particles_with(*maps: list[Floats], Sigma: Floats | None = None) -> Particles:
    """One particle at the origin for each map; walls that are missing in the shorter maps are no walls there."""
    K, most = len(maps), max(map(len, maps))
    theta, new = np.zeros((K, most, 8)), np.zeros((K, most), bool)
    for k, walls in enumerate(maps):
        theta[k, : len(walls)], new[k, : len(walls)] = walls, True
    Sigma = np.zeros((2, 2)) if Sigma is None else Sigma
    whole = MapStore(WALL).empty(K).append(new, theta, np.tile(Sigma, (K, most, 1, 1)), np.arange(most))
    return initial(WALL, ORIGIN, np.zeros((3, 3)), Params(particles=K))._replace(maps=whole)


def merged(particles: Particles, frame: Frame, n: list[list[int]], params: Params = PARAMS) -> tuple[Particles, Ints]:
    """What `merge_features` makes of it, and the correspondences."""
    R = noise_of_known(frame, observation_noise(frame, params), params)
    after, n_after, _ = merge_features(particles, frame, np.array(n), R, params)
    return after, n_after


def walls_left(walls: list[Floats], piece: Floats, n: int = 0, **changes: Any) -> Ints:
    """Indices of what one particle's map has after a piece was paired with wall n."""
    params = Params(**{**vars(PARAMS), **changes})
    after, _ = merged(particles_with(walls), frame_of(piece), [[n]], params)
    return after.maps.indices(0)


@pytest.mark.parametrize("preset", [{}, LOG])
@pytest.mark.parametrize("paired", [0, 1])
def test_two_copies_are_merged(paired: int, preset: dict[str, Any]) -> None:
    """4 cm apart: the younger one is gone, whichever the piece was paired with; now it is paired with the elder one."""
    walls = [along_x(-2.0, 1.0, -1.0), along_x(-0.5, 3.0, -1.04), along_x(-2.0, 2.0, 3.0)]
    particles, frame = particles_with(walls), frame_of(seen_along_x(-1.0, 2.0, -1.02))
    after, n = merged(particles, frame, [[paired]], Params(**{**vars(PARAMS), **preset}))
    assert n.tolist() == [[0]]
    assert after.maps.indices(0).tolist() == [0, 2]
    theta = after.maps.features(0)[0]
    np.testing.assert_array_equal(theta[1], walls[2])
    np.testing.assert_allclose(theta[0], [-0.5, -1.0, 0.0, -1.5, 3.5, 0.0, 0.0, 4.0])  # frozen, as long as both


FAR_APART = {
    "the faces of a thin wall": ([along_x(-2, 2, -1.0), along_x(-2, 2, -1.04, math.pi)], seen_along_x(-1, 1, -1.02)),
    "shelves": ([along_x(-2, 2, -1.0), along_x(-2, 2, -1.3)], seen_along_x(-1, 1, -1.15)),
    "a closed door": ([along_x(-2, 2, -1.0), along_x(-2, 2, -1.12)], seen_along_x(-1, 1, -1.06)),
    "a bend": ([along_x(-2, 2, -1.0), along_x(-2, 2, -1.0, 0.15)], seen_along_x(-1, 1, -1.0, angle=0.07)),
    "across a door": (
        [along_x(-4, -0.5, -1.0, ends=(0, 1)), along_x(0.5, 4, -1.0, ends=(1, 0))],
        seen_along_x(-2, 2, -1.0),
    ),
    "one jamb seen": ([along_x(-4, -0.5, -1.0, ends=(0, 1)), along_x(0.5, 4, -1.0)], seen_along_x(-2, 2, -1.0)),
    "the other jamb seen": ([along_x(-4, -0.5, -1.0), along_x(0.5, 4, -1.0, ends=(1, 0))], seen_along_x(-2, 2, -1.0)),
    "two rooms, of which one is seen": ([along_x(-4, -0.5, -1.0), along_x(0.5, 4, -1.0)], seen_along_x(-3, 0.0, -1.0)),
    "hardly both": ([along_x(-4, -0.5, -1.0), along_x(0.5, 4, -1.0)], seen_along_x(-3, 0.5 + 0.9 * SAME_END, -1.0)),
    "the piece is of one": ([along_x(-2, 2, -1.0), along_x(-2, 2, -1.09)], seen_along_x(-1, 1, -0.9)),
}


@pytest.mark.parametrize("case", FAR_APART)
@pytest.mark.parametrize("paired", [0, 1])
def test_what_is_two_stays_two(case: str, paired: int) -> None:
    """Also where the first one is the younger."""
    walls, piece = FAR_APART[case]
    assert walls_left(walls, piece, paired).tolist() == [0, 1]
    assert walls_left(walls[::-1], piece, paired).tolist() == [0, 1]


@pytest.mark.parametrize("case", sorted(set(FAR_APART) - {"the piece is of one"}))
def test_wide_gates_merge_no_more(case: str) -> None:
    """With nine times R and a gate that lets half a metre in."""
    walls, piece = FAR_APART[case]
    assert walls_left(walls, piece, **LOG).tolist() == [0, 1]


def test_a_piece_over_a_gap_that_nobody_saw_the_end_of_makes_one() -> None:
    """Two pieces of a wall, once hidden between by somebody; and seen ends that are the same end are no objection."""
    walls = [along_x(-4, -0.5, -1.0), along_x(0.5, 4, -1.0)]
    assert walls_left(walls, seen_along_x(-2, 2, -1.0)).tolist() == [0]
    walls = [along_x(-4, 2.1, -1.0, ends=(0, 1)), along_x(0.5, 2.3, -1.0, ends=(0, 1))]
    after, _ = merged(particles_with(walls), frame_of(seen_along_x(-2, 2, -1.0)), [[0]])
    theta = after.maps.features(0)[0]
    assert len(theta) == 1
    np.testing.assert_allclose(theta[0, :2] + [theta[0, 3], 0], [-4, -1])
    np.testing.assert_allclose(theta[0, 0] + theta[0, 4], 2.1)  # the end as the elder one has it
    assert theta[0, 5:7].tolist() == [0.0, 1.0]


def test_only_what_a_paired_piece_shows_is_merged() -> None:
    walls = [along_x(-2.0, 1.0, -1.0), along_x(-0.5, 3.0, -1.04)]
    piece = seen_along_x(-1.0, 2.0, -1.02)
    for nothing in (NEW, IGNORED):
        assert walls_left(walls, piece, nothing).tolist() == [0, 1]
    assert walls_left(walls, piece, merge_walls=False).tolist() == [0, 1]
    assert walls_left(walls, piece, association="known").tolist() == [0, 1]  # tags say what is one


@pytest.mark.parametrize("paired", [[2, 1], [0, 1], [1, 2], [0, 2]])
def test_a_wall_is_merged_once_a_step_and_the_rest_later(paired: list[int]) -> None:
    walls = [along_x(-2, 2, -1.0), along_x(-2, 2, -1.01), along_x(-2, 2, -1.03)]
    pieces = frame_of(seen_along_x(-1.5, -0.5, -1.0), seen_along_x(0.5, 1.5, -1.0))
    after, n = merged(particles_with(walls), pieces, [paired])
    assert len(after.maps.indices(0)) == 2
    assert set(n[0].tolist()) <= set(after.maps.indices(0).tolist())
    after, n = merged(after, pieces, n.tolist())
    assert after.maps.indices(0).tolist() == [0]
    assert n.tolist() == [[0, 0]]


def test_two_pieces_extend_the_wall_that_both_are_paired_with_now() -> None:
    """One at either end: neither is lost."""
    walls = [along_x(-2.0, 1.0, -1.0), along_x(-0.5, 3.0, -1.01)]
    pieces = frame_of(seen_along_x(-3.0, 0.0, -1.0), seen_along_x(0.5, 4.0, -1.0))
    after, n = merged(particles_with(walls), pieces, [[0, 1]])
    assert n.tolist() == [[0, 0]]
    (theta,) = extend_features(after, pieces, n).maps.features(0)[0]
    np.testing.assert_allclose(theta[0] + theta[3:5], [-3.0, 4.0])
    assert theta[7] == 6.0


def test_particles_that_share_a_map_are_independent() -> None:
    """Three copies of one; the piece is paired in two of them.  The younger wall is in another leaf than the elder."""
    elsewhere = [along_x(-1.0, 1.0, y) for y in (3.0, 5.0, 7.0, 9.0)]
    walls = [along_x(-2.0, 1.0, -1.0), *elsewhere, along_x(-0.5, 3.0, -1.04)]
    one = particles_with(walls)
    shared = one._replace(
        s=np.zeros((3, 3)), P=np.zeros((3, 3, 3)), log_w=np.zeros(3), lineage=np.zeros(3, np.int64),
        maps=one.maps.select(np.zeros(3, np.int64)),
    )  # fmt: skip
    after, n = merged(shared, frame_of(seen_along_x(-1.0, 2.0, -1.02)), [[0], [NEW], [5]])
    assert [after.maps.indices(k).tolist() for k in range(3)] == [[*range(5)], [*range(6)], [*range(5)]]
    assert n.tolist() == [[0], [NEW], [0]]
    np.testing.assert_array_equal(after.maps.features(1)[0], walls)
    for before in (shared.maps, one.maps):
        np.testing.assert_array_equal(before.features(0)[0], walls)


def test_each_particle_has_its_own_walls() -> None:
    """The same indices are two copies for one particle and two walls for the other."""
    copies, shelves = [along_x(-2, 2, -1.0), along_x(-2, 2, -1.04)], [along_x(-2, 2, -1.0), along_x(-2, 2, -1.4)]
    after, _ = merged(particles_with(copies, shelves), frame_of(seen_along_x(-1, 1, -1.0)), [[0], [0]])
    assert [after.maps.indices(k).tolist() for k in range(2)] == [[0], [0, 1]]


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (30.0, -7.0, 2.9)])
def test_two_estimates_are_fused_as_kalman_has_it(place: tuple[float, float, float]) -> None:
    """The product of two Gaussians, in the frame of the elder one; for lines that are all but parallel it is exact."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        angle, t = place[2], rng.uniform(-5, 5)
        axis, left = np.array([math.cos(angle), math.sin(angle)]), np.array([-math.sin(angle), math.cos(angle)])
        elder = np.array([*place, -2.0, 2.0, 0, 0, 3.0])
        offset, turned = rng.normal(0, 0.03), rng.normal(0, 1e-5)
        younger = np.array([*(place[:2] + t * axis + offset * left), wrap(angle + turned), -1.0, 1.0, 0, 0, 5.0])
        root = rng.normal(0, 0.02, (2, 2, 2)) * np.array([[1.0], [0.2]])
        Sigma, Sigma_other = root @ root.swapaxes(1, 2)
        theta, fused = united(WALL, elder, tuple(map(tuple, Sigma)), younger, tuple(map(tuple, Sigma_other)))
        moved = np.array([[1.0, -t], [0.0, 1.0]])  # what the younger one says at the origin of the elder
        at_elder = moved @ Sigma_other @ moved.T
        expected = np.linalg.inv(np.linalg.inv(Sigma) + np.linalg.inv(at_elder))
        mean = expected @ np.linalg.inv(at_elder) @ moved @ [offset, turned]
        np.testing.assert_allclose(fused, expected, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose((np.array(theta[:2]) - place[:2]) @ left, mean[0], atol=1e-6)
        np.testing.assert_allclose((np.array(theta[:2]) - place[:2]) @ axis, 0.0, atol=1e-9)
        np.testing.assert_allclose(wrap(theta[2] - angle), mean[1], atol=1e-6)
        assert theta[7] == 8.0


def test_the_distance_is_that_beside_the_piece() -> None:
    """By matrices: two lines far from where they were made, as wrong as the floors and their Sigma make them there."""
    elder, younger = np.array([-10.0, 0, 0, -1, 21, 0, 0, 1]), np.array([14.0, 0.18, 0.01, -15, 1, 0, 0, 1])
    model, Sigma, other = np.diag([2e-3, 1e-5]), np.diag([1e-3, 2e-5]), np.array([[4e-3, 1e-4], [1e-4, 3e-5]])
    piece = seen_along_x(1.0, 5.0, 0.05)
    t, along = 3.0 - 14.0, 13.0
    lever, elder_lever = np.array([[1, t], [0, 1]]), np.array([[1, along], [0, 1]])
    V = elder_lever @ (Sigma + model) @ elder_lever.T + lever @ (other + model) @ lever.T
    v = np.array([0.18 + t * 0.01, 0.01])
    found = distance(WALL, elder, *(tuple(map(tuple, Sigma)), younger, tuple(map(tuple, other))), ORIGIN, piece,
                     tuple(map(tuple, model)))  # fmt: skip
    assert found == pytest.approx(v @ np.linalg.solve(V, v), rel=0.02)
    assert abs(along) < LEVER


# What is gone ------------------------------------------------------------------------------------------------------


def test_nobody_sees_what_is_gone() -> None:
    """Not the search, not the tags, not who reads the map; but what comes next has an index of its own."""
    walls = [along_x(-2.0, 1.0, -1.0), along_x(-0.5, 3.0, -1.04)]
    frame = frame_of(seen_along_x(1.5, 2.5, -1.04))
    gone = particles_with(walls)
    gone = gone._replace(maps=gone.maps.remove(np.array([[1]])))
    R = noise_of_known(frame, observation_noise(frame, PARAMS), PARAMS)
    there = particles_with(walls)
    assert associate(there, frame, R, PARAMS).tolist() == [[1]]
    assert associate(gone, frame, R, Params(gate_new=0.0)).tolist() == [[0]]  # within the slack of the elder one
    assert gone.maps.find(np.array([0, 1])).tolist() == [[0, NEW]]
    assert [len(part) for part in gone.maps.features(0)] == [1, 1, 1]
    assert gone.maps.tags(0).tolist() == [0, UNKNOWN_TAG]
    assert len(gone.maps.everything(10)[1]) == 1
    grown = gone.maps.append(np.ones((1, 1), bool), walls[1][None, None], np.zeros((1, 1, 2, 2)), np.array([7]))
    assert grown.indices(0).tolist() == [0, 2]
    assert grown.tags(0).tolist() == [0, UNKNOWN_TAG, 7]


@pytest.mark.parametrize("key", FILTERS)
def test_every_filter_merges_and_says_so(key: str) -> None:
    """The step returns the map without the copy, correspondences with what is left, and numbers of what is left."""
    walls = [along_x(-2.0, 1.0, -1.0), along_x(-0.5, 3.0, -1.04)]
    start = particles_with(walls, Sigma=np.zeros((2, 2)) if key == "dfs" else np.diag([1e-4, 1e-6]))
    frame = frame_of(seen_along_x(-1.0, 2.0, -1.02), seen_along_x(-1.0, 1.0, 2.0, angle=math.pi))
    frame = frame._replace(tags=np.array([1, 5]))
    after, trace = ESTIMATORS[key].step(np.random.default_rng(0), start, frame, PARAMS)
    assert trace.n.tolist() == [[0, NEW]]
    assert trace.merged is not None
    assert trace.merged.tolist() == [[1, NEW]]
    for maps in (trace.weighted.maps, after.maps):
        assert maps.indices(0).tolist() == [0, 2]
        assert maps.tags(0).tolist() == [0, UNKNOWN_TAG, 5]
    assert trace.predicted.maps.indices(0).tolist() == [0, 1]
    measures = measure(trace, frame)
    assert (measures.features, measures.duplicates) == (2, 0.0)
    assert (measures.correct, measures.wrong, measures.missed) == (1, 1, 0)  # the tag of the copy is gone with it
    _, off = ESTIMATORS[key].step(
        np.random.default_rng(0), start, frame, Params(**{**vars(PARAMS), "merge_walls": False})
    )
    assert off.merged is None
    assert off.weighted.maps.indices(0).tolist() == [0, 1, 2]


@pytest.mark.parametrize("key", FILTERS)
def test_a_piece_does_not_lie_along_a_wall_because_it_extends_it(key: str) -> None:
    """It ends before the younger wall, of which it is taken to be: nobody has seen what lies between the two."""
    walls = [along_x(-4, -0.5, -1.06), along_x(0.5, 4, -1.0)]
    start = particles_with(walls, Sigma=np.zeros((2, 2)) if key == "dfs" else np.diag([1e-4, 1e-6]))
    _, trace = ESTIMATORS[key].step(np.random.default_rng(0), start, frame_of(seen_along_x(-3, 0.3, -1.0)), PARAMS)
    assert trace.n.tolist() == [[1]]
    theta = trace.weighted.maps.features(0)[0]
    assert len(theta) == 2
    assert theta[1, 0] + theta[1, 3] == pytest.approx(-3, abs=0.1)  # extended it is


@pytest.mark.parametrize("key", FILTERS)
def test_where_nothing_is_to_be_done_nothing_changes(key: str) -> None:
    """Not a bit: six steps along two walls, merging and with a limit that is not reached, and without."""
    frames = [
        frame_of(seen_along_x(-2, 2, -1.0 + 0.01 * t), seen_along_x(-2, 2, -2.0 - 0.01 * t, angle=math.pi))
        for t in range(6)
    ]
    found = []
    for changes in ({"merge_walls": False}, {"merge_walls": True, "most_new": 2}):
        params = Params(**{**vars(PARAMS), "particles": 7, **changes})
        state, rng = initial(WALL, ORIGIN, np.diag([0.01, 0.01, 1e-4]), params), np.random.default_rng(5)
        for frame in frames:
            state, trace = ESTIMATORS[key].step(rng, state, frame, params)
        found.append([state.s, state.P, state.log_w, trace.n, *(x for k in range(7) for x in state.maps.features(k))])
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


# A limit on what one scan adds ------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", [*FILTERS, "ekf"])
@pytest.mark.parametrize(("most", "kept"), [(0, [0, 1, 2, 3]), (1, [2]), (2, [0, 2]), (4, [0, 1, 2, 3])])
def test_a_scan_adds_the_best(key: str, most: int, kept: list[int]) -> None:
    """Those whose angle is known best; what was ignored is in no map."""
    pieces = [seen_along_x(-1.0, 1.0, y, (EDGE, CORNER)) for y in (-1.0, -3.0, -5.0, -7.0)]
    for piece, variance in zip(pieces, (2e-6, 4e-6, 1e-6, 3e-6), strict=True):
        piece[6] = variance
    params = Params(particles=3, believed=PARAMS.believed, most_new=most)
    state = ESTIMATORS[key].init(WALL, ORIGIN, np.zeros((3, 3)), params)
    _, trace = ESTIMATORS[key].step(np.random.default_rng(0), state, frame_of(*pieces), params)
    expected = [NEW if i in kept else IGNORED for i in range(4)]
    assert trace.n.tolist() == [expected] * len(trace.n)
    assert trace.weighted.maps.counts.tolist() == [len(kept)] * len(trace.n)


def test_what_is_known_counts_not_toward_the_limit() -> None:
    """One particle has the best one in its map, the other has not."""
    pieces = [seen_along_x(-1.0, 1.0, y) for y in (-1.0, -3.0, -5.0)]
    for piece, variance in zip(pieces, (1e-6, 2e-6, 3e-6), strict=True):
        piece[6] = variance
    frame, params = frame_of(*pieces), Params(most_new=1)
    particles = particles_with([along_x(-1, 1, -1.0)], [along_x(-1, 1, 4.0)])
    R = noise_of_known(frame, observation_noise(frame, params), params)
    assert associate(particles, frame, R, params).tolist() == [[0, NEW, IGNORED], [NEW, IGNORED, IGNORED]]
