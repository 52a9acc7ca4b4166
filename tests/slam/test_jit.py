"""What is compiled once is compiled anew when any source of the package has changed.

Numba alone looks at the file that the kernel stands in.  Shown on a small package around a copy of `slam/_jit.py`, each
step in a process of its own, as the disk cache is read at the start of one.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from slam import _jit
from slam._jit import inline, kernel

MATHEMATICS = """
from mini._jit import inline


@inline
def f(x):
    return x + {constant}
"""

KERNEL = """
from mini._jit import kernel
from mini.mathematics import f


@kernel
def g(x):
    return f(x)
"""

PLAIN_KERNEL = KERNEL.replace("from mini._jit import kernel", "import numba").replace(
    "@kernel", "@numba.njit(cache=True)"
)

PROGRAM = """
from mini.kernels import g

print(g(1.0), sum(g.stats.cache_hits.values()))
"""


class Mini:
    """A package `mini` in a folder of its own, and a program that uses it."""

    def __init__(self, folder: Path, kernels: str) -> None:
        self.folder, self.package = folder, folder / "mini"
        self.package.mkdir()
        shutil.copy(_jit.__file__, self.package / "_jit.py")
        self.write("__init__.py", "")
        self.write("kernels.py", kernels)
        self.write("mathematics.py", MATHEMATICS.format(constant="10.0"))

    def write(self, name: str, text: str) -> None:
        """Write a file that claims to be as old as all others, as those of an installed package do."""
        path = self.package / name
        path.write_text(text, encoding="utf-8")
        os.utime(path, (1_580_601_600, 1_580_601_600))

    def run(self) -> tuple[float, int]:
        """g(1), and how often a compiled form of it came from the cache."""
        environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
        environment |= {"PYTHONPATH": str(self.folder), "PYTHONDONTWRITEBYTECODE": "1"}
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        value, hits = done.stdout.split()
        return float(value), int(hits)


def test_a_change_in_another_file_is_noticed(tmp_path: Path) -> None:
    mini = Mini(tmp_path, KERNEL)
    assert mini.run() == (11.0, 0)
    assert mini.run() == (11.0, 1)  # nothing changed: not compiled again
    mini.write("mathematics.py", MATHEMATICS.format(constant="20.0"))  # of the same length
    assert mini.run() == (21.0, 0)
    assert mini.run() == (21.0, 1)


def test_numba_alone_does_not_notice(tmp_path: Path) -> None:
    """Why `kernel` is needed, and that the test above can fail.  Should this fail one day, Numba has learnt it."""
    mini = Mini(tmp_path, PLAIN_KERNEL)
    assert mini.run() == (11.0, 0)
    mini.write("mathematics.py", MATHEMATICS.format(constant="20.0"))
    assert mini.run() == (11.0, 1)


def test_every_kernel_has_the_stamp_of_the_package() -> None:
    """Numba's own name for the stamp is private; if it moves, this fails rather than the mathematics."""
    from slam import association, map_store, phases

    for compiled in (association._associate, map_store._find, phases._predict):
        assert compiled._cache._cache_file._source_stamp == _jit._package_stamp()


def test_a_kernel_elsewhere_depends_on_its_own_file_too(tmp_path: Path) -> None:
    place = tmp_path / "elsewhere.py"
    stamps = []
    for text in ("a = 1\n", "a = 2\n"):
        place.write_text(text, encoding="utf-8")
        stamps.append(_jit._stamp(place))
    assert stamps[0] != stamps[1]
    assert all(stamp.startswith(_jit._package_stamp()) for stamp in stamps)


@pytest.mark.parametrize("compile_", [kernel, inline], ids=["kernel", "inline"])
def test_compiled_code_cannot_allocate(compile_: Callable[..., Any]) -> None:
    def allocates(x: int) -> Any:
        return np.zeros(x)[0]

    with pytest.raises(numba.core.errors.NumbaError, match=r"No implementation of function.*zeros"):
        compile_(allocates)(3)


def test_arithmetic_is_that_of_numpy() -> None:
    """1 / 0 is infinite and no error, which the innovation of a feature at the robot relies on."""
    assert inline(lambda a, b: a / b)(1.0, 0.0) == np.inf
