"""A real browser without a window, which draws in software."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

FLAGS = ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
"""WebGL without graphics hardware: slow, a picture or two in a second."""

DRAWN_AFTER = 120.0
"""[s] that it may take to show something, on a machine that has other things to do."""

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@contextmanager
def browser() -> Iterator[Any]:
    """Chromium; a machine that has none skips the test, but never on CI."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        reason = f"no browser; install one of: {', '.join(NAMES)}"
        if os.environ.get("CI", "").lower() == "true":
            pytest.fail(reason)
        pytest.skip(reason)
    from playwright.sync_api import sync_playwright

    flags = [*FLAGS, *(["--no-sandbox"] if os.geteuid() == 0 else [])]
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=found, args=flags)
        try:
            yield chromium
        finally:
            chromium.close()


def watched(page: Any) -> tuple[set[str], list[str]]:
    """What a page asks for, by scheme, host and port, and its errors; both grow from now on."""
    asked: set[str] = set()
    errors: list[str] = []
    page.on("request", lambda request: asked.add("/".join(request.url.split("/")[:3])))
    page.on("console", lambda message: errors.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: errors.append(str(error)))
    return asked, errors


def picture(page: Any, element: str) -> bytes:
    """PNG of a part of the page."""
    box = page.locator(element).bounding_box()
    return page.screenshot(clip=box, timeout=1e3 * DRAWN_AFTER)
