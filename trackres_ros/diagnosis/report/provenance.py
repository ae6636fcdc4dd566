# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Provenance of a page: time, command, versions and hashes of the inputs."""

from __future__ import annotations

import hashlib
import platform
import shlex
import sys
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import scipy

from trackres_ros.version import __version__


def provenance(recordings: Sequence[Path], others: Sequence[Path], seconds: float | None) -> tuple[tuple[str, str], ...]:
    """Name and text of each item of the provenance.

    Parameters
    ----------
    recordings, others
        Files and folders read; each gets a SHA-256, for a folder over its contents in the order of names.
    seconds
        Duration of the diagnosis; None if unknown.
    """
    said = [
        ("made", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"),
        (
            "version",
            f"trackres {__version__}, Python {platform.python_version()}, numpy {np.__version__}, scipy {scipy.__version__}",
        ),
        ("command", shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])),
    ]
    if seconds is not None:
        said.append(("duration", f"{seconds:.1f} s, without this page"))
    said += [(path.name, f"SHA-256 {digest}") for path in (*recordings, *others) if (digest := sha256(path))]
    return tuple(said)


def sha256(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder in sequence; empty if neither exists."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else []
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as content:
            while block := content.read(1 << 20):
                digest.update(block)
    return digest.hexdigest() if files else ""
