"""Rerun's own program, which comes with the package: where it is, and how it is run without leaving it behind."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

GUARD = """
exec 3<&0
"$@" </dev/null 3<&- & program=$!
{ read -r _ <&3; kill -9 $program; } 2>/dev/null & guard=$!
exec 3<&-
wait $program; code=$?
kill -9 $guard 2>/dev/null
exit $code
"""
"""Runs a program until that ends, or until nobody holds the other end of the standard input any more: whichever way
whoever started it ends, kill -9 included, the program does not outlive it."""

PATIENCE = 5.0
"""[s] that a program is given to be gone."""


def binary() -> Path:
    """The program itself; the command `rerun` is a script around it, and ending that leaves the program running."""
    import rerun_cli

    folder = Path(rerun_cli.__file__).parent
    return next((p for p in (folder / "rerun", folder / "rerun.exe") if p.exists()), folder / "rerun")


class Program:
    """Rerun's program, running in the background; it ends with this process at the latest."""

    def __init__(self, arguments: Sequence[str]) -> None:
        # With CI it sends no statistics about its use to anybody, and says nothing about them either.
        self._folder = tempfile.TemporaryDirectory(prefix="dualslam-", ignore_cleanup_errors=True)  # what it leaves
        environment = {**os.environ, "CI": "true", "NO_COLOR": "1", "RUST_LOG": "warn", "TMPDIR": self._folder.name}
        self._said = tempfile.TemporaryFile("w+", errors="replace")  # noqa: SIM115 - closed in `close`
        self._process = subprocess.Popen(
            ["/bin/sh", "-c", GUARD, "sh", str(binary()), *arguments],
            stdin=subprocess.PIPE,
            stdout=self._said,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,  # Ctrl-C is not for it
        )

    @property
    def alive(self) -> bool:
        """Whether it runs."""
        return self._process.poll() is None

    def said(self) -> str:
        """The last line of what it has to say."""
        if self._said.closed:
            return ""
        self._said.seek(0)
        lines = self._said.read().strip().splitlines()
        return lines[-1] if lines else ""

    def close(self) -> None:
        """End it."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            self._process.stdin.close()
        try:
            self._process.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, 9)  # its session has nobody else in it
            self._process.wait()
        self._said.close()
        self._folder.cleanup()
