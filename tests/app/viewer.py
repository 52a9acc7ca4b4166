"""The real Rerun viewer without a window: what a recording looks like, and what the viewer complains about."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

SHOWN_AFTER = 60.0
"""[s] that a viewer without graphics hardware may take to start, or to show something."""

T = TypeVar("T")


class Viewer:
    """A viewer process of its own, that listens on 127.0.0.1 only.  Use it as a context manager."""

    def __init__(self, recording: Path | str) -> None:
        import rerun_cli

        self.recording = recording
        self._binary = Path(rerun_cli.__file__).parent / "rerun"
        self._log = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed in __exit__
        self._client: Any = None

    def __enter__(self) -> Viewer:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = str(probe.getsockname()[1])
        self._process = subprocess.Popen(
            [str(self._binary), "--headless", "--bind", "127.0.0.1", "--port", port, str(self.recording)],
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        try:
            self._wait("the viewer", lambda: self._connect(port))
            self._wait("the recording", lambda: self._state().recordings and self._state().views)
            self._settle()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._log.close()

    def seek(self, timeline: str, sequence: int) -> None:
        """Go to a moment and stay there."""
        self._client.set_time(timeline, sequence=sequence, play_state="paused")
        self._settle()

    def views(self) -> list[Any]:
        """All views of the blueprint, also those behind other tabs: `name`, `view_class`, `view_id`, `reports`."""
        return list(self._state().views)

    def timelines(self) -> set[str]:
        """Names of the timelines of the recording."""
        return {t.name for t in self._state().recordings[0].timelines}

    def last_step(self) -> int | None:
        """The last step that the first recording has."""
        return next((int(t.end) for t in self._state().recordings[0].timelines if t.name == "step"), None)

    def active(self) -> int | None:
        """Which of the recordings is shown, the first being 0."""
        state = self._state()
        names = [recording.store_id for recording in state.recordings]
        active = state.active_recording
        return names.index(active) if active in names else None

    def bring_to_front(self, view: Any) -> None:
        """Choose the tabs that the view lies behind."""
        blueprint = self._client.get_blueprint("recording").blueprint
        inner, found = f"view/{view.view_id}", True
        while found:
            found = False
            for path, parts in blueprint.items():
                container = parts.get("ContainerBlueprint", {})
                if inner in container.get("contents", ()):
                    if container["container_kind"] == "Tabs":
                        container["active_tab"] = inner
                    inner, found = path.lstrip("/"), True
                    break
        self._client.set_blueprint(blueprint, "recording")
        self._settle()

    def switch_on(self, entity: str) -> None:
        """What somebody does with the eye of a hidden entity, in all views."""
        blueprint = self._client.get_blueprint("recording").blueprint
        hidden = [parts["EntityBehavior"] for path, parts in blueprint.items() if f"/overrides{entity}/" in f"{path}/"]
        assert hidden
        assert not any(behaviour["visible"] for behaviour in hidden)
        for behaviour in hidden:
            behaviour["visible"] = True
        self._client.set_blueprint(blueprint, "recording")
        self._settle()

    def in_front(self) -> set[str]:
        """`view_id` of all views that no other tab hides."""
        blueprint = self._client.get_blueprint("recording").blueprint
        found, ahead = set(), [f"container/{blueprint['/viewport']['ViewportBlueprint']['root_container']}"]
        while ahead:
            kind, _, name = ahead.pop().partition("/")
            if kind == "view":
                found.add(name)
                continue
            container = blueprint[f"/container/{name}"]["ContainerBlueprint"]
            tabs = container["container_kind"] == "Tabs"
            ahead += [container["active_tab"]] if tabs else container["contents"]
        return found

    def screenshot(self, view: Any = None) -> bytes:
        """PNG of the whole window, or of a view that is in front."""
        return self._client.take_screenshot(view.view_id if view else None)

    def complaints(self) -> list[str]:
        """Warnings and errors of the viewer as a whole, except about the missing graphics hardware."""
        said = [f"{entry.level}: {entry.message}" for entry in self._client.get_logs() if entry.level != "INFO"]
        return [line for line in said if "rasterizer" not in line]

    def _connect(self, port: str) -> bool:
        from rerun.experimental import ViewerClient

        if self._process.poll() is not None:
            raise ViewerDied(self._said())
        try:
            self._client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            self._client.get_state()
        except Exception:  # whatever it is, until it listens
            return False
        return True

    def _state(self) -> Any:
        return self._client.get_state()

    def _settle(self) -> None:
        """Two pictures later, what was asked for is on the screen."""
        for _ in range(2):
            self._client.take_screenshot(max_size=16)

    def _wait(self, what: str, condition: Callable[[], T]) -> T:
        until = time.monotonic() + SHOWN_AFTER
        while time.monotonic() < until:
            if result := condition():
                return result
            time.sleep(0.1)
        raise ViewerDied(f"{what} did not appear within {SHOWN_AFTER:.0f} s\n{self._said()}")

    def _said(self) -> str:
        self._log.seek(0)
        return self._log.read()[-2000:]


class ViewerDied(RuntimeError):
    """The viewer could not be started, or showed nothing."""


def required_viewer(recording: Path | str) -> Viewer:
    """A started viewer; a machine that cannot draw skips the test, but never on CI."""
    viewer = Viewer(recording)
    try:
        return viewer.__enter__()
    except ViewerDied as error:
        reason = f"the headless Rerun viewer does not start (it wants a Vulkan driver: mesa-vulkan-drivers): {error}"
        if os.environ.get("CI", "").lower() == "true" or "graphics adapter" not in reason.lower():
            pytest.fail(reason)
        pytest.skip(reason)


def pixels(png: bytes) -> np.ndarray:
    """(height, width, 3) of a picture."""
    from PIL import Image

    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


def share_drawn(png: bytes) -> float:
    """Share of the pixels that differ from the most frequent colour."""
    colours, counts = np.unique(pixels(png).reshape(-1, 3), axis=0, return_counts=True)
    return 1.0 - counts.max() / counts.sum() if len(colours) > 1 else 0.0
