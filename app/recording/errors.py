"""What can go wrong with a recording, in one sentence each, and how a recording is recognised."""

from __future__ import annotations

from app.errors import UsageError

MAGIC = b"RRF"
"""First bytes of every Rerun recording: RRF2 today, RRF0 and RRF1 in the past."""


class RecordingError(UsageError):
    """A recording that cannot be begun or read."""


class RecordingLost(RecordingError):
    """A recording that could not be carried on; what it held until then is kept."""
