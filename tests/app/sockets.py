"""Who listens where, as the system tells it."""

from __future__ import annotations

import os
import socket
import struct
from pathlib import Path

LISTENS = "0A"


def family(pid: int) -> list[int]:
    """A process and all that descend from it."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            stat = (folder / "stat").read_text()
        except OSError:
            continue
        parents[int(folder.name)] = int(stat.rpartition(")")[2].split()[1])
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def listening(pid: int) -> set[tuple[str, int]]:
    """(address, port) on which a process or one of its descendants listens."""
    sockets = _sockets()
    return {sockets[inode] for one in family(pid) for inode in _inodes(one) if inode in sockets}


def _sockets() -> dict[str, tuple[str, int]]:
    found = {}
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        if not os.path.exists(table):
            continue
        for line in Path(table).read_text().splitlines()[1:]:
            _, local, _, state, *rest = line.split()
            if state == LISTENS:
                address, port = local.split(":")
                found[rest[5]] = (_readable(address), int(port, 16))
    return found


def _readable(address: str) -> str:
    words = [int(address[i : i + 8], 16) for i in range(0, len(address), 8)]
    kind = socket.AF_INET if len(words) == 1 else socket.AF_INET6
    return socket.inet_ntop(kind, struct.pack(f"={len(words)}I", *words))


def _inodes(pid: int) -> set[str]:
    found = set()
    try:
        for link in Path(f"/proc/{pid}/fd").iterdir():
            try:
                target = os.readlink(link)
            except OSError:
                continue
            if target.startswith("socket:["):
                found.add(target[8:-1])
    except OSError:  # it has ended
        pass
    return found
