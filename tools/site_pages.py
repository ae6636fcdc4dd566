# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What the site has besides docs/: tables of the program, pages of the root, linked files, equations without a script.

mkdocs calls these functions; mkdocs.yml names this file.
"""

from __future__ import annotations

import ast
import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from reference_pages import PAGES as REFERENCE

ROOT = Path(__file__).resolve().parents[1]
PAGES = {name: name for name in ("CONTRIBUTING.md", "QUALITY_DECLARATION.md", "SECURITY.md")} | {"index.md": "README.md"}
LINKED = ("CHANGELOG.rst", "LICENSE", "package.xml", "config/*.yaml", "config/rubber/*.csv", "examples/*.py", "examples/*.ipynb")
EXAMPLES = "examples/index.md"
STYLE = ".md-grid { max-width: 76rem; }"  # the tables are wide
FETCHED = re.compile(r'(?:\ssrc="|<link(?![^>]*rel="canonical")[^>]*\shref=")(?:https?:)?//[^"]*')


def on_files(files: Files, config: Any) -> Files:
    """Add what lies outside docs/."""
    for page, source in PAGES.items():
        files.append(File.generated(config, page, abs_src_path=str(ROOT / source)))
    for pattern in LINKED:
        for path in sorted(ROOT.glob(pattern)):
            files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    files.append(File.generated(config, EXAMPLES, content=examples()))
    files.append(File.generated(config, "site.css", content=STYLE))
    return files


def examples() -> str:
    """Each script of examples/: what it is for, its code, and what it printed when tools/site ran it."""
    lines = ["# Examples", "", "Also as a notebook: [front_door.ipynb](front_door.ipynb), the Python interface.", ""]
    for path in sorted(ROOT.glob("examples/*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        code = "\n".join(path.read_text(encoding="utf-8").splitlines()[tree.body[0].end_lineno or 0 :]).strip("\n")
        lines += [f"## {path.name}", "", " ".join((ast.get_docstring(tree) or "").split()), "", f"[Download]({path.name})", ""]
        lines += ["```python", code, "```", ""]
        printed = ROOT / "out" / "examples" / f"{path.stem}.txt"
        if printed.exists():
            lines += ["It prints:", "", "```text", printed.read_text(encoding="utf-8").rstrip("\n"), "```", ""]
    return "\n".join(lines)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Tables of the program, and links as they lead on the site, where the root and docs/ are one folder."""
    if "/" in page.file.src_uri:
        return markdown
    if f"docs/{page.file.src_uri}" in REFERENCE:
        markdown = REFERENCE[f"docs/{page.file.src_uri}"]()
    markdown = markdown.replace("](docs/", "](").replace("](../", "](")
    return markdown.replace("](examples)", f"]({EXAMPLES})").replace("](decisions/)", "](decisions/README.md)")


def on_page_content(content: str, **_: Any) -> str:
    """Equations as MathML, which browsers draw by themselves."""

    def drawn(match: re.Match[str]) -> str:
        latex = html.unescape(match.group("latex"))
        latex = latex.replace("''", "\N{DOUBLE PRIME}").replace("'", "\N{PRIME}")  # which any font draws in its place
        return str(convert(latex, display="block" if match.group("tag") == "div" else "inline"))

    return re.sub(
        r'<(?P<tag>span|div) class="arithmatex">\\[(\[](?P<latex>.*?)\\[)\]]</(?P=tag)>', drawn, content, flags=re.DOTALL
    )


def on_post_build(config: Any) -> None:
    """Refuse a site that would fetch anything from elsewhere: it is to be read without a network."""
    for page in sorted(Path(config.site_dir).rglob("*.html")):
        found = FETCHED.search(page.read_text(encoding="utf-8"))
        if found:
            raise PluginError(f"{page.name} would fetch {found.group().strip()}")
