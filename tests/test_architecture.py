"""Who may import whom: app -> scenarios -> slam, what draws where it belongs, nothing happens at import."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGES = ("slam", "scenarios", "app")
MAY_IMPORT = {"slam": {"slam"}, "scenarios": {"scenarios", "slam"}, "app": {"app", "scenarios", "slam"}}
HOMES = {
    "rerun": ["app/recording"],
    "rerun_bindings": ["app/recording"],
    "viser": ["app/panel"],
    "matplotlib": ["app/plotting", "app/compare/plots", "app/study/consistency_plot", "app/lessons/drawn"],
}
UNKNOWN_TO_SLAM = {"time", "datetime", "pathlib", "io", "os", "rich", "tyro", "json", "socket", "requests"}
"""Clocks, files and screens."""

FILES = [path for package in PACKAGES for path in sorted((ROOT / package).rglob("*.py"))]


def imported(path: Path) -> set[str]:
    """The modules that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: a relative import hides where it leads"
            found.add(node.module or "")
    return found


def name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_there_are_files():
    assert len(FILES) > 30


@pytest.mark.parametrize("path", FILES, ids=name)
def test_directions(path):
    package = name(path).split("/")[0]
    ours = {module.split(".")[0] for module in imported(path)} & {*PACKAGES, "tests"}
    assert ours <= MAY_IMPORT[package]


@pytest.mark.parametrize("path", FILES, ids=name)
def test_what_draws_has_its_homes(path):
    for module in imported(path):
        homes = HOMES.get(module.split(".")[0])
        places = tuple(f"{home}{end}" for home in homes or () for end in ("/", ".py"))
        assert homes is None or name(path).startswith(places), module


@pytest.mark.parametrize("path", [path for path in FILES if name(path).startswith("slam/")], ids=name)
def test_slam_knows_neither_files_nor_clocks(path):
    if path.name == "_jit.py":  # numba's cache is keyed by the files of the package
        return
    assert not {module.split(".")[0] for module in imported(path)} & UNKNOWN_TO_SLAM


@pytest.mark.parametrize("path", FILES, ids=name)
def test_no_global_random_state(path):
    text = path.read_text(encoding="utf-8")
    assert "np.random.seed" not in text
    assert "import random" not in text


def test_importing_loads_no_viewer_and_opens_no_file():
    """Everything but the recording is imported, in a fresh process that may open no file of its own."""
    modules = [name(path)[:-3].replace("/", ".").removesuffix(".__init__") for path in FILES]
    modules = [module for module in modules if not module.startswith(("app.recording", "app.panel"))]
    program = f"""
import sys, importlib
import numpy, numba, rich.progress, rich.table, tyro
import multiprocessing, concurrent.futures, scipy.special, importlib.metadata
opened = []
def hook(event, arguments):
    path = str(arguments[0]) if arguments else ""
    mine = path.endswith((".py", ".pyc", ".nbi", ".nbc", ".so")) or "__pycache__" in path or "/site-packages" in path
    if event == "socket.connect" or (event == "open" and not mine and not path.startswith("<") and not path.isdigit()):
        opened.append((event, path))
sys.addaudithook(hook)
for module in {modules!r}:
    importlib.import_module(module)
assert not opened, opened
assert not {{"rerun", "viser"}} & set(sys.modules), "loaded too early"
"""
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
