# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reads small text files of the user: completely, or refuses them in one line; it never blocks."""

from pathlib import Path

from trackres_ros.errors import InputError
from trackres_ros.files import own_files


def read_text(path: Path, what: str, most_bytes: int) -> str:
    """The text of a file in UTF-8, from any editor: without a byte order mark, each line ended by a line feed.

    `what`: expected kind, such as "YAML file", for messages; `most_bytes`: a longer one is refused. Raises InputError if there is
    no such file, it is a folder, pipe or device, too long, or no UTF-8.
    """
    try:
        text = read_bytes(path, what, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(str(path), f"byte {error.start} is not UTF-8", f"a {what} in UTF-8") from None
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_bytes(path: Path, what: str, most_bytes: int) -> bytes:
    """The bytes of a file; see `read_text`."""
    try:
        return own_files.read(path, most_bytes)
    except OSError as error:
        raise InputError(str(path), error.strerror or str(error), f"a readable {what}") from None


def is_there(path: Path) -> bool:
    """Whether a path leads to anything; not if its name is too long for one."""
    try:
        return path.exists()
    except OSError:
        return False
