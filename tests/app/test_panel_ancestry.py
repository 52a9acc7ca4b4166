"""The ancestry in the panel: pictures and words of the step where the session stands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from app import ancestry, colours, session
from app.live.engine import Engine
from app.panel.descent import HEIGHT, SHORTEST, WIDTH, described, picture
from app.panel.panel import Panel
from scenarios.registry import build
from slam.estimators import ESTIMATORS
from slam.genealogy import Genealogy
from tests.app.live import at
from tests.app.test_panel import make, soon

BACKGROUND = np.array(colours.BACKGROUND)
RGB = colours.of_filter("dfs")


def grown(*ancestors: list[int]) -> Genealogy:
    genealogy = Genealogy.start(np.zeros((len(ancestors[0]), 3)))
    for step in ancestors:
        genealogy = genealogy.grow(np.array(step), np.zeros((len(step), 3)))
    return genealogy


def test_a_picture_by_hand() -> None:
    """In the second step the second of four founders has three children, and so the last two die."""
    tree = ancestry.tree(grown([0, 1, 2, 3], [0, 1, 1, 1], [0, 1, 2, 3]), RGB)
    pixels = picture(tree, 3, 6, RGB)
    assert pixels.shape == (HEIGHT, WIDTH, 3)
    present = WIDTH // 2
    future = pixels[1:-1, present + 1 : -1]
    np.testing.assert_array_equal(future, np.broadcast_to(BACKGROUND, future.shape))
    assert (pixels[:, present] == 255).all(axis=1).sum() > HEIGHT - 20
    column = pixels[1:-1, present - 20].tolist()  # four lines, each two pixels thick
    lit = [tuple(p) for p in column if tuple(p) != tuple(colours.BACKGROUND)]
    assert lit == [colours.FOUNDERS[0]] * 2 + [colours.FOUNDERS[1]] * 6
    begin = {tuple(p) for p in pixels[1:-1, 20].tolist()}
    dim = {tuple(np.array(t, np.uint8).tolist()) for t, s in zip(tree.tones, tree.share, strict=True) if s == 0.0}
    assert len(dim) == 2
    assert dim <= begin


def test_nothing_is_drawn_outside_the_frame() -> None:
    rng = np.random.default_rng(0)
    tree = ancestry.tree(grown(*(np.sort(rng.integers(300, size=300)).tolist() for _ in range(50))), RGB)
    pixels = picture(tree, 50, 50, RGB)
    frame = np.array(colours.faded(RGB, 0.5))
    np.testing.assert_array_equal(pixels[[0, -1]], np.broadcast_to(frame, (2, WIDTH, 3)))
    drawn = (pixels[1:-1] != BACKGROUND).any(axis=2)
    assert drawn.any(axis=0).all()
    assert 0.02 < drawn.mean() < 0.7


@pytest.fixture(scope="module")
def live() -> Iterator[tuple[Engine, Panel]]:
    engine, panel, _ = make(build("paper-line"), ("dfs", "ekf"))
    yield engine, panel
    panel.close()
    engine.close(20.0)


def test_the_page_shows_it(live: tuple[Engine, Panel]) -> None:
    engine, panel = live
    page = panel.ancestry
    soon(lambda: page.nothing.visible)
    engine.step(12)
    at(engine, 12)
    update = session_update(engine, "dfs")
    soon(lambda: page.words["dfs"].content == described("dfs", update))
    expected = picture(ancestry.tree(update.genealogy, RGB), 12, SHORTEST, RGB)
    soon(lambda: np.array_equal(page.pictures["dfs"].image, expected))
    assert page.words["dfs"].visible
    assert page.pictures["dfs"].visible
    assert not page.nothing.visible
    for key in ("ekf", "fs1", "fs2"):  # of one particle there is nothing to show, and the others are off
        assert not page.words[key].visible
        assert not page.pictures[key].visible


def test_it_follows_to_an_earlier_step_and_a_filter_that_is_switched_on(live: tuple[Engine, Panel]) -> None:
    engine, panel = live
    page = panel.ancestry
    engine.go(4)
    at(engine, 4)
    update = session_update(engine, "dfs")
    expected = picture(ancestry.tree(update.genealogy, RGB), 4, SHORTEST, RGB)
    soon(lambda: np.array_equal(page.pictures["dfs"].image, expected))
    engine.put({"filters": ["fs2", "ekf"]})
    engine.step()
    soon(lambda: page.pictures["fs2"].visible and not page.pictures["dfs"].visible)


def session_update(engine: Engine, key: str) -> session.FilterUpdate:
    taken = engine.status.taken
    assert taken is not None
    return taken.step.filters[key]


def test_what_is_said(live: tuple[Engine, Panel]) -> None:
    info = session.make_info(build("paper-line"), [ESTIMATORS["fs1"]], seed=3, count=12)
    update = list(session.steps(info))[-1].filters["fs1"]
    said = described("fs1", update)
    assert said.startswith("**FastSLAM 1.0**: ")
    assert ", all from one of " in said
    copies, holders = update.trace.weighted.maps.hypotheses()
    i = int(np.argmin(copies / holders))
    assert f"; feature {i} has the fewest hypotheses left, {copies[i]} in {holders[i]} maps" in said
