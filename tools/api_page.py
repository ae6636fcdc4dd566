# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""docs/api.md out of the docstrings of the front door."""

import inspect
import re
from collections.abc import Callable
from typing import Any

from marks import page_with

import trackres_ros as tr

FUNCTIONS = (
    "load_vehicle", "check_vehicle", "record_sample", "read", "recover", "replay", "simulate", "explain", "diagnose", "coastdown",
)  # fmt: skip
CLASSES = (
    "Recording", "ReplayResult", "SimulationResult", "OperatingPoint", "VehicleCheck", "DiagnosisResult", "CoastdownResult",
    "Estimator", "Vehicle",
    "OwnModel", "Sample", "Recovered", "InputError",
)  # fmt: skip
MEMBERS = {  # of classes whose other members are for the inside of the package
    "Recording": ("start_ns", "roles", "time_s", "aligned", "report"),
    "Estimator": ("inputs", "cold_start", "step", "run", "rest", "session"),
    "Vehicle": ("weight", "nominal_loads", "track_of"),
    "InputError": ("as_dict",),
    "OwnModel": ("known",),
}
PARAGRAPH = "\n\n"
SECTIONS = ("Parameters", "Attributes", "Returns", "Raises", "Examples")


def page() -> str:
    """The whole page."""
    return page_with(
        "docs/api.md",
        functions="\n".join(_described(f"`{name}`", getattr(tr, name)) for name in FUNCTIONS),
        effects=_plain(inspect.getdoc(tr.effects) or ""),
        objects="\n".join(_of_class(name, getattr(tr, name)) for name in CLASSES),
    )


def _of_class(name: str, of: type) -> str:
    members = MEMBERS.get(name) or [n for n, _ in inspect.getmembers(of) if not n.startswith("_") and _is_own(of, n)]
    lines = []
    for member in members:
        value = inspect.getattr_static(of, member)
        text = inspect.getdoc(getattr(of, member)) or ""
        signature = _signature(value) if inspect.isfunction(value) else ""
        lines.append(f"- `.{member}{signature}`: {_plain(_sections(text)['']).partition(PARAGRAPH)[0]}")
    listed = "\n".join(["", "Members:", "", *lines, ""]) if lines else ""
    return _described(f"`{name}`", of, with_signature=False) + listed


def _is_own(of: type, member: str) -> bool:
    """Whether a member is of this package: not of a mapping, and not a field that the docstring lists already."""
    value = inspect.getattr_static(of, member)
    home = next(c for c in of.__mro__ if member in c.__dict__)
    return home.__module__.startswith("trackres_ros") and not inspect.ismemberdescriptor(value)


def _described(title: str, of: Any, with_signature: bool = True) -> str:
    found = _sections(inspect.getdoc(of) or "")
    parts = [f"### {title}\n"]
    if with_signature:
        parts.append(f"```python\n{of.__name__}{_signature(of)}\n```\n")
    parts.append(f"{_plain(found[''])}\n")
    for section in SECTIONS[:-1]:
        if section in found:
            parts.append(f"{section}:\n\n{_entries(found[section])}\n")
    if "Examples" in found:
        parts.append(f"```pycon\n{found['Examples'].strip()}\n\n```\n")
    return "\n".join(parts)


def _signature(of: Callable[..., Any]) -> str:
    """Names and defaults; what they may be is said below."""
    signature = inspect.signature(of)
    shown = [p.replace(annotation=inspect.Parameter.empty) for n, p in signature.parameters.items() if n != "self"]
    shown = [p.replace(default=_Shown("...")) if callable(p.default) and p.default is not p.empty else p for p in shown]
    returned = f" -> {signature.return_annotation}" if isinstance(signature.return_annotation, str) else ""
    return f"{signature.replace(parameters=shown, return_annotation=inspect.Signature.empty)}{returned.replace(' -> None', '')}"


class _Shown(str):
    """A default that is shown as it is written."""

    def __repr__(self) -> str:
        return str(self)


def _sections(text: str) -> dict[str, str]:
    """A docstring by its sections; the head is ''."""
    pieces = re.split(rf"^({'|'.join(SECTIONS)})\n-+\n", text, flags=re.MULTILINE)
    return {"": pieces[0], **dict(zip(pieces[1::2], pieces[2::2], strict=True))}


def _entries(text: str) -> str:
    """Entries of a section as a list."""
    found = re.split(r"^(?=\S)", text.strip() + "\n", flags=re.MULTILINE)
    lines = []
    for entry in filter(None, found):
        name, _, about = entry.partition("\n")
        name = name.partition(" : ")[0]  # types are in the signatures
        lines.append(f"- `{name.strip()}`: {_plain(inspect.cleandoc(about))}" if about.strip() else f"- {_plain(name)}")
    return "\n".join(lines)


def _plain(text: str) -> str:
    """Paragraphs of one line each, with the code marks of Markdown."""
    paragraphs = re.split(r"\n\s*\n", text.strip())
    return "\n\n".join(re.sub(r"``([^`]+)``", r"`\1`", " ".join(p.split())) for p in paragraphs)
