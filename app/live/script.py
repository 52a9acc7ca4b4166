"""A live session as a script: what was asked for at which step, so that it can be run again, headless, bit for bit.

    {"schema": 1, "command": "dualslam live ...", "seed": n, "world": name, "mistake": name | null,
     "branches": [{"name": "", "parent": null, "at": 0, "steps": n, "digest": text,
                   "changes": [{"step": i, "params": {...}, "noise": {...}, "filters": [...]}, ...]}, ...]}

`changes` are the settings from step `step` on; `at` is the step after which a branch left its parent; `digest` tells
whether two runs of the branch's own steps are the same in every bit of every pose, covariance and weight.  A filter
that was switched on late is what it would be had it always been on: so a replay runs every filter that was ever on.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple

from app.errors import UsageError, listed, sentence, suggestion
from app.live.history import Branch, History, digest_of
from app.live.settings import Settings, ordered, plain
from app.options import FILTERS, MISTAKES
from app.session import Change
from app.types import SessionInfo, SessionStep
from slam.limits import PARAMS
from slam.types import Noise, Params

SCHEMA = 1
MOST = 64 << 20
"""[bytes] of a script."""


def script_of(history: History) -> dict[str, Any]:
    """All branches so far, as JSON has them."""
    info = history.info
    return {
        "schema": SCHEMA,
        "command": info.command,
        "seed": info.seed,
        "world": info.source.name,
        "mistake": info.mistake or None,
        "branches": [_branch(branch) for branch in history.branches],
    }


def _branch(branch: Branch) -> dict[str, Any]:
    return {
        "name": branch.name,
        "parent": branch.parent.name if branch.parent else None,
        "at": branch.at,
        "steps": branch.done,
        "digest": branch.digest,
        "changes": [{"step": first, **plain(settings)} for first, settings in branch.changes],
    }


class Replay(NamedTuple):
    """One branch of a script, from the very first step."""

    command: str
    seed: int
    steps: int
    changes: tuple[tuple[int, Settings], ...]
    """From which step on which settings hold; the first is for step 1."""
    own_from: int
    """The first step that is the branch's own."""
    digest: str
    mistake: str = ""
    """That the filters had in them."""

    @property
    def filters(self) -> tuple[str, ...]:
        """That were ever on."""
        return ordered(tuple(key for _, settings in self.changes for key in settings.filters))

    def session_changes(self) -> list[Change]:
        """As `app.session` takes them."""
        return [Change(first, settings.params, settings.noise) for first, settings in self.changes[1:]]

    def on(self, index: int) -> tuple[str, ...]:
        """The filters that were on in a step."""
        return [settings for first, settings in self.changes if first <= index][-1].filters


def read_replay(path: Path, branch: str = "") -> Replay:
    """One branch of a script file; `UsageError` if there is none."""
    return replay_of(_parsed(path), branch, str(path))


def _parsed(path: Path) -> Any:
    try:
        with path.open("rb") as file:
            data = file.read(MOST + 1)
    except OSError as error:
        raise UsageError(f"--replay {path} cannot be read: {sentence(error)}") from None
    if len(data) > MOST:
        raise UsageError(
            f"--replay {path} is larger than {MOST >> 20} MiB; expected a session that dualslam live saved"
        )
    try:
        return json.loads(data)
    except ValueError:
        raise UsageError(f"--replay {path} is no session; expected the JSON that dualslam live saves") from None


def replay_of(script: Any, name: str, where: str) -> Replay:
    """One branch of a parsed script; `UsageError`, naming `where` it is from, for what is no script."""
    try:
        if script["schema"] != SCHEMA:
            raise UsageError(f"--replay {where} has schema {script['schema']!r}; expected {SCHEMA}")
        branches = {branch["name"]: branch for branch in script["branches"]}
        if name not in branches:
            known = [other for other in branches if other]
            expected = f"expected {listed(known)}" if known else "it has no branches"
            raise UsageError(f"--branch is {name!r}, which is not in {where}{suggestion(name, known)}; {expected}")
        changes = _line(branches, name, set())
        found = branches[name]
        replay = Replay(
            str(script["command"]), int(script["seed"]), int(found["steps"]), tuple(changes), int(found["at"]) + 1,
            str(found["digest"]), script.get("mistake") or "",
        )  # fmt: skip
        if replay.changes[0][0] != 1 or replay.seed < 0 or replay.mistake not in ("", *MISTAKES):
            raise ValueError
        return replay
    except UsageError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        raise UsageError(f"--replay {where} is no session; expected what dualslam live saves") from None


def _line(branches: dict[str, Any], name: str, seen: set[str]) -> list[tuple[int, Settings]]:
    """The changes of a branch and of those that it came from."""
    if name in seen:
        raise ValueError("a branch that came from itself")
    branch = branches[name]
    own = [(int(change["step"]), _settings(change)) for change in branch["changes"]]
    if branch["parent"] is None:
        return own
    before = _line(branches, branch["parent"], seen | {name})
    return [change for change in before if change[0] <= int(branch["at"])] + own


def _settings(change: dict[str, Any]) -> Settings:
    params = dict(change["params"])
    params["believed"] = Noise(**params["believed"])
    for name, limits in PARAMS.items():
        if params[name] not in limits:
            raise ValueError(name)
    filters = tuple(change["filters"])
    if not filters or not set(filters) <= set(FILTERS):
        raise ValueError("filters")
    return Settings(Params(**params), Noise(**change["noise"]), ordered(filters))


class Check:
    """An observer that finds out whether a replay is the session, bit for bit."""

    def __init__(self, replay: Replay) -> None:
        self._replay = replay
        self._digest = ""
        self._last = 0

    def begin(self, info: SessionInfo) -> None:
        """Nothing to do."""

    def step(self, step: SessionStep) -> None:
        """The filters that were on."""
        self._last = step.index
        if step.index >= self._replay.own_from:
            self._digest = digest_of(self._digest, step, self._replay.on(step.index))

    def end(self) -> None:
        """Nothing to do."""

    @property
    def same(self) -> bool:
        """Whether it is, to the end."""
        own = self._replay.steps >= self._replay.own_from
        return self._last == self._replay.steps and (not own or self._digest == self._replay.digest)

    def told(self) -> str:
        """A sentence."""
        if self._last < self._replay.steps:
            return f"replay: stopped after {self._last} of {self._replay.steps} steps"
        if self._replay.steps < self._replay.own_from:
            return "replay: the branch has no steps of its own, so there is nothing to compare"
        if self._digest == self._replay.digest:
            return "replay: every pose, covariance and weight is that of the session, bit for bit"
        return "replay: NOT the numbers of the session; other versions of the packages, or another processor?"
