# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the C of an estimator: header, source, a program that replays a CSV, and a CMake file."""

from __future__ import annotations

import hashlib
import json
import re
import textwrap
from collections.abc import Iterable, Iterator
from pathlib import Path

from trackres_ros.effects.calls import CALL
from trackres_ros.errors import InputError
from trackres_ros.estimator import columns as layout
from trackres_ros.estimator.records import LONGEST_STEP_S
from trackres_ros.kernels.extension import fill_template, used_helpers
from trackres_ros.kernels.functions import Instance
from trackres_ros.kernels.kinds import INT, REAL, WIDE, ArrayOf, Record, safe_name
from trackres_ros.recording.roles import ROLES, UNITS
from trackres_ros.tools.export.parts import Parts, StateArray

TEMPLATES = Path(__file__).parent / "templates"
OF_MESSAGE = {"channel": "channel", "stamp": "stamp_ns", "arrival": "arrival_ns", "value": "value"}
CHECKED_BYTES = 8  # version and checksum, before the arrays

SCALES = {role: {name: UNITS[about.unit][unit].scale for name, unit in about.columns.items()} for role, about in ROLES.items()}
"""Columns of a table for each role, and the scale to its own unit."""
UNIT_OF = {role: next(name for name, scale in names.items() if scale == 1.0) for role, names in SCALES.items()}
"""The column of a table in the role's own unit: inputs have these names."""


def input_names(channels: tuple[str, ...]) -> dict[str, str]:
    """For each channel the name of its input: `weight_n/front` of `load/front`."""
    return {channel: UNIT_OF[channel.partition("/")[0]] + "".join(channel.partition("/")[1:]) for channel in channels}


def in_c(name: str) -> str:
    """A name of a column in C."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name)


def check_names(channels: Iterable[str]) -> None:
    """Refuse names of axles and assemblies that are one name in C: channels have constants in capitals there."""
    known_names: dict[str, str] = {}
    for channel in channels:
        other_channel, name = known_names.setdefault(in_c(channel).upper(), channel), channel.partition("/")[2]
        if other_channel != channel:
            allowed = "names that differ in letters or digits, without regard to capitals"
            raise InputError(
                "export", f"{other_channel.partition('/')[2]} and {name}", allowed, "rename one of them in the vehicle file"
            )


class CSource:
    """The files of an export as texts; `made` are lines on its origin, for the head of each file."""

    def __init__(self, parts: Parts, title: str, lines_of_origin: tuple[str, ...]) -> None:
        self.parts, self.translator = parts, parts.translator
        self.real = self.translator.number(REAL)
        self._title = _ascii(title)
        self._origin_text = "\n".join(f" * {_ascii(line)}" for line in lines_of_origin)
        self.estimator = parts.estimator
        check_names(self.estimator.channels)
        self.inputs = input_names(self.estimator.channels)
        self.columns = [name for name in self.estimator.columns if name != "reasons"]
        self._body = self._functions()

    def files(self) -> dict[str, str]:
        """Each file by its name."""
        common = {"TITLE": self._title, "MADE": self._origin_text, "REAL": self.real, "VERSION": self.version()}
        values = {"trackres.h": self._header(), "trackres.c": self._source(), "main.c": self._main(), "CMakeLists.txt": {}}
        return {
            name: fill_template((TEMPLATES / name).read_text(encoding="utf-8"), common | names) for name, names in values.items()
        }

    def version(self) -> str:
        """Version number of the state: a digest of everything that defines the numbers in a state."""
        start = "\n".join(line for array in self.parts.arrays for line in self._initial(array))
        digest = hashlib.sha256("\n".join([*self._body.values(), self._state(), start]).encode()).hexdigest()
        return f"0x{digest[:8]}"

    def state_bytes(self) -> int:
        """Size of a state."""
        width = {INT: 8, WIDE: 8, REAL: 4 if self.translator.single else 8}
        return CHECKED_BYTES + sum(width[array.kind.element] * self._length(array) for array in self.parts.arrays)

    # The header

    def _header(self) -> dict[str, str]:
        reasons = [
            f"    TRACKRES_{reason.name} = {int(reason):#x}, /* {_ascii(text)} */" for reason, text in layout.REASON_TEXT.items()
        ]
        channels = [f"    TRACKRES_CHANNEL_{in_c(channel).upper()} = {i}," for i, channel in enumerate(self.estimator.channels)]
        return {
            "LONGEST_STEP": repr(LONGEST_STEP_S),
            "VEHICLE": json.dumps(_ascii(self.estimator.vehicle.source.stem)),
            "REASONS": _without_last_comma(reasons),
            "CHANNELS": _without_last_comma(channels),
            "INPUTS": "\n".join(f"    trackres_real {in_c(name)};" for name in self.inputs.values()),
            "OUTPUTS": "\n".join(f"    trackres_real {in_c(name)};" for name in self.columns),
            "STATE": self._state(),
        }

    def _state(self) -> str:
        return "\n".join(
            f"    {'trackres_real' if array.kind.element == REAL else self.translator.number(array.kind.element)} "
            f"{in_state(array)}[{self._length(array)}]; /* {_shape(array)}{array.axes} */"
            for array in self.parts.arrays
        )

    def _length(self, array: StateArray) -> int:
        """Number of elements of a state array in C; with `float` the total is even, so that there is no gap."""
        reals = sum(int(state_array.start.size) for state_array in self.parts.arrays if state_array.kind.element == REAL)
        return int(array.start.size) + (reals % 2 if self.translator.single and array is self.parts.arrays[-1] else 0)

    # The source

    def _functions(self) -> dict[str, str]:
        functions = self.translator.text_of_functions(list(self.parts.entries.values()))
        dispatch = self.parts.effects.text() if f"{CALL}(" in functions else ""
        prototype = f"{self.parts.effects.prototype}\n" if dispatch else ""
        functions = f"{functions}\n{dispatch}" if dispatch else functions
        tables = self.translator.text_of_tables()
        return {
            "HELPERS": used_helpers(self.translator, functions),
            "STRUCTS": self.translator.text_of_structs(functions),
            "TABLES": tables,
            "PROTOTYPES": prototype,
            "FUNCTIONS": functions,
        }

    def _source(self) -> dict[str, str]:
        entries = self.parts.entries
        arrays = self.parts.arrays
        return {
            **self._body,
            "STATE_BYTES": str(self.state_bytes()),
            "INIT": "\n".join(line for array in arrays for line in self._initial(array)),
            "NO_INPUTS": "\n".join(f"    inputs->{in_c(name)} = NAN;" for name in self.inputs.values()),
            "ROW": "\n".join(self._row()),
            "GIVEN": "\n".join(f"        inputs->{in_c(name)}," for name in self.inputs.values()),
            "CHANNEL_COUNT": str(len(self.inputs)),
            "HARMLESS": f"{int(layout.HARMLESS):#x}",
            "RECORDS_OF_ANSWER": self._records(entries["feedforward_now"], entries["reasons_now"], const=True),
            "RECORDS_OF_STEP": self._records(entries["step"]),
            "RECORDS_OF_MESSAGE": self._records(entries["take_message"]),
            "RECORDS_OF_REST": self._records(entries["rest_after"]),
            "FEEDFORWARD": self._call(entries["feedforward_now"], motion="state->motion", latest="latest"),
            "REASONS_NOW": self._call(entries["reasons_now"], latest="latest"),
            "IS_STALE": self._call(entries["is_stale"], latest="latest"),
            "STEP": self._call(entries["step"], given="given", dt="dt", out="state->row"),
            "MESSAGE": self._call(entries["take_message"], **OF_MESSAGE, out="state->row"),
            "REST": self._call(entries["rest_after"], ambient="ambient_degc", seconds="seconds"),
        }

    def _initial(self, array: StateArray) -> Iterator[str]:
        name, length = f"state->{in_state(array)}", self._length(array)
        numbers = [*array.start.ravel().tolist(), *[0.0] * (length - array.start.size)]
        literals = [self.translator.literal(value) for value in numbers]
        if len(set(literals)) == 1:
            yield f"    for (int i = 0; i < {length}; i++) {{\n        {name}[i] = {literals[0]};\n    }}"
            return
        body = textwrap.fill(", ".join(literals), 110, initial_indent="            ", subsequent_indent="            ")
        kind = self.translator.number(array.kind.element)
        yield f"    {{\n        static const {kind} start[{length}] = {{\n{body}\n        }};"
        yield f"        for (int i = 0; i < {length}; i++) {{\n            {name}[i] = start[i];\n        }}\n    }}"

    def _row(self) -> Iterator[str]:
        for i, name in enumerate(self.estimator.columns):
            if name == "reasons":
                yield f"    outputs->reasons = (uint32_t)state->row[{i}];"
            else:
                yield f"    outputs->{in_c(name)} = state->row[{i}];"

    def _records(self, *entries: Instance, const: bool = False) -> str:
        """Declare the records that functions take, of the arrays of a state."""
        record_kinds = {name: kind for entry in entries for name, kind in entry.given if isinstance(kind, Record)}
        lines = []
        for name, kind in record_kinds.items():
            lines.append(f"    const {self.translator.struct(kind)} {name} = {self._filled_record(kind, const)};")
        return "\n".join(lines)

    def _filled_record(self, kind: Record, const: bool) -> str:
        """The initializer of a record: arrays of the state, tuned numbers, records of these."""
        parts = []
        for field, part in kind.stored_fields():
            if isinstance(part, Record):
                parts.append(self._filled_record(part, const))
            elif not isinstance(part, ArrayOf):
                parts.append(f"state->tuned[{self.parts.tuned.index(field)}]")
            else:
                cast = f"({self.translator.declaration(part).removesuffix('*')}*)" if const else ""
                parts.append(f"{cast}state->{safe_name(field)}")
        return f"{{{', '.join(parts)}}}"

    def _call(self, instance: Instance, **given: str) -> str:
        """The call of an entry: records by their names, arrays of the state, and other arguments as given."""
        codes = [f"&{name}" if isinstance(kind, Record) else given.get(name, f"state->{name}") for name, kind in instance.given]
        return f"{instance.name}({', '.join(codes)})"

    # The program that replays

    def _main(self) -> dict[str, str]:
        known_lines = []
        for channel, name in self.inputs.items():
            role, slash, part = channel.partition("/")
            for column, scale in SCALES[role].items():
                known_lines.append(f'    {{"{column}{slash}{part}", offsetof(trackres_inputs, {in_c(name)}), {float(scale)!r}}},')
        output_lines = [f'    {{"{name}", offsetof(trackres_outputs, {in_c(name)}), 1.0}},' for name in self.columns]
        return {"INPUT_COLUMNS": "\n".join(known_lines), "OUTPUT_COLUMNS": "\n".join(output_lines)}


def in_state(array: StateArray) -> str:
    """The name of an array in the struct of the state."""
    return array.name.removeprefix("carried_")


def _shape(array: StateArray) -> str:
    return " x ".join(map(str, array.start.shape)) + ": " if len(array.start.shape) > 1 else ""


def _without_last_comma(lines: list[str]) -> str:
    lines[-1] = lines[-1].replace(",", "", 1)
    return "\n".join(lines)


def _ascii(text: str) -> str:
    return text.encode("ascii", "replace").decode().replace("*/", "* /")
