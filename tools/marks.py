# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Parts of pages that commands write, between the marks <!-- NAME --> and <!-- /NAME -->: whole lines, or words of a sentence."""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def page_with(name: str, **parts: str) -> str:
    """The text of a page of the repository with new parts."""
    page = (ROOT / name).read_text(encoding="utf-8")
    for part, text in parts.items():
        marked = re.compile(rf"(<!-- {part} -->(\n?)).*?(<!-- /{part} -->)", re.DOTALL)
        page, count = marked.subn(lambda m, text=text: f"{m[1]}{text.strip()}{m[2]}{m[3]}", page)
        if count != 1:
            raise ValueError(f"{name} has {count} parts {part}")
    return page


def write_page(name: str, **parts: str) -> None:
    """Write the new parts into a page of the repository."""
    (ROOT / name).write_text(page_with(name, **parts), encoding="utf-8")
