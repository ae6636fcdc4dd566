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
    """What it is and what it says, in words.

    Parameters
    ----------
    recordings, others
        What was read; its SHA-256 is given where it is a file or a folder, over the contents in the order of names.
    seconds
        How long the diagnosis took; None where nobody knows.
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
    """Of a file, or of all files of a folder one after the other; empty where there is neither."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else []
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as content:
            while block := content.read(1 << 20):
                digest.update(block)
    return digest.hexdigest() if files else ""
