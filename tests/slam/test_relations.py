"""The metric of relations, against its definition."""

from __future__ import annotations

import math

import numpy as np
import pytest

from slam.geometry import compose, invert
from slam.relations import belongs, relation_errors, within

RNG = np.random.default_rng(5)
STAMPS = 1e9 + np.array([0.0, 0.5, 0.4, 1.0, 1.5, 2.0])  # one steps back
PATH = np.column_stack([RNG.normal(0, 5, (6, 2)), RNG.uniform(-math.pi, math.pi, 6)])


def between(i: int, k: int) -> np.ndarray:
    return compose(invert(PATH[i]), PATH[k])


PAIRS = [(0, 1), (1, 2), (5, 0), (3, 3), (4, 2)]
TIMES = np.array([[STAMPS[i], STAMPS[k]] for i, k in PAIRS])
EXACT = np.array([between(i, k) for i, k in PAIRS])


def test_a_path_that_fits_has_no_errors() -> None:
    moved = compose(np.array([7.0, -3.0, 2.0]), PATH)
    found = relation_errors(STAMPS, moved, TIMES, EXACT)
    assert (found.used, found.left_out) == (5, 0)
    assert found.translation_m is not None
    assert found.rotation_rad is not None
    assert max(found.translation_m) < 1e-12
    assert max(found.rotation_rad) < 1e-12


def test_errors_are_those_of_the_second_pose_seen_from_the_first() -> None:
    lengths, angles = np.array([0.1, 0.2, 0.3, 0.4, 3.0]), np.array([0.1, -0.2, 0.3, -3.0, 0.0])
    direction = RNG.uniform(-math.pi, math.pi, 5)
    off = np.column_stack([lengths * np.cos(direction), lengths * np.sin(direction), np.zeros(5)])
    relations = EXACT + off
    relations[:, 2] += angles + math.tau  # any whole turn
    found = relation_errors(STAMPS, PATH, TIMES, relations)
    for spread, errors in ((found.translation_m, lengths), (found.rotation_rad, np.abs(angles))):
        assert spread is not None
        assert spread.mean == pytest.approx(errors.mean())
        assert spread.std == pytest.approx(math.sqrt(np.mean(errors**2) - errors.mean() ** 2))
        assert spread.median == pytest.approx(sorted(errors)[2])
        assert spread.max == pytest.approx(max(errors))
        assert sorted(errors)[3] < spread.p95 < max(errors)


def test_relations_whose_scans_are_not_in_the_path_are_counted() -> None:
    times = np.array([*TIMES, [STAMPS[0], STAMPS[0] + 0.2], [0.0, STAMPS[1]], [STAMPS[1] + 0.00005, STAMPS[0]]])
    relations = np.array([*EXACT, [9.0, 9.0, 0.0], [9.0, 9.0, 0.0], between(1, 0)])
    found = relation_errors(STAMPS, PATH, times, relations)
    assert (found.used, found.left_out) == (6, 2)
    assert found.translation_m is not None
    assert found.translation_m.max < 1e-12
    assert belongs(times, STAMPS).tolist() == [True] * 5 + [False, False, True]
    assert within(times, STAMPS).tolist() == [True] * 6 + [False, True]


def test_without_any_relation_nothing_is_known() -> None:
    found = relation_errors(STAMPS, PATH, np.array([[1.0, 2.0]]), np.zeros((1, 3)))
    assert found == (0, 1, None, None)
    assert relation_errors(STAMPS, PATH, np.zeros((0, 2)), np.zeros((0, 3))) == (0, 0, None, None)


def test_a_time_is_that_of_the_nearest_scan() -> None:
    """Real logs have scans 0.6 ms apart; what is farther than a tenth of one is none."""
    stamps = np.array([10.0, 10.0006, 10.0012, 11.0])
    path = np.column_stack([np.arange(4.0), np.zeros(4), np.zeros(4)])
    for i in range(4):
        for off in (-0.00009, 0.0, 0.00009):
            times = np.array([[stamps[i] + off, 11.0]])
            found = relation_errors(stamps, path, times, np.array([[3.0 - i, 0.0, 0.0]]))
            assert found.translation_m is not None
            assert found.translation_m.max < 1e-12
    nowhere = np.array([[9.9998, 11.0], [10.0003, 11.0], [10.0014, 11.0], [11.0, 11.0002]])
    assert belongs(nowhere, stamps).tolist() == [False] * 4
    assert relation_errors(stamps, path, nowhere, np.zeros((4, 3))).left_out == 4


def test_a_path_of_one_pose() -> None:
    times = np.array([[5.0, 5.0], [5.0, 6.0], [4.0, 5.0]])
    found = relation_errors(np.array([5.0]), np.array([[1.0, 2.0, 3.0]]), times, np.tile([0.3, 0.4, -0.1], (3, 1)))
    assert (found.used, found.left_out) == (1, 2)
    assert found.translation_m == pytest.approx((0.5, 0.0, 0.5, 0.5, 0.5))
    assert found.rotation_rad == pytest.approx((0.1, 0.0, 0.1, 0.1, 0.1))
