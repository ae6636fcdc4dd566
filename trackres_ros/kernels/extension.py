# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes the C of a module of Python with entries: the kernels, and for each entry a function that takes its arguments."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from types import FunctionType

from trackres_ros.kernels.functions import TEMPLATES, Instance, Translator
from trackres_ros.kernels.kinds import (
    BOOL,
    INT,
    LARGEST_WHOLE,
    LENGTH,
    REAL,
    ArrayOf,
    Const,
    Kind,
    Record,
    Scalar,
    kinds_of,
    safe_name,
)

TAKEN = {REAL: "tr_real", INT: "tr_int", BOOL: "tr_truth"}
LETTERS = {REAL: "d", INT: "l", BOOL: "?"}
GIVEN_BACK = {REAL: "PyFloat_FromDouble({})", INT: "PyLong_FromLongLong({})", BOOL: "PyBool_FromLong({})"}
HEAD = """/* Written when the package is built, from its kernels in Python: see trackres_ros/kernels. */
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

#include <math.h>
#include <stdbool.h>
#include <stdint.h>
"""


class Extension:
    """The C of a module with some entries, by their names.

    Parameters
    ----------
    module
        Its name without those of packages.
    constants
        Texts that it has as attributes.
    """

    def __init__(
        self, module: str, translator: Translator, entries: Mapping[str, FunctionType], constants: Mapping[str, str] | None = None
    ) -> None:
        self.translator, self._module, self._constants = translator, module, dict(constants or {})
        self.entries = {name: translator.instance(function, kinds_of(function)) for name, function in entries.items()}
        self._records: dict[str, Record] = {}
        records = [kind for instance in self.entries.values() for kind in instance.arguments.values() if isinstance(kind, Record)]
        self._given = set(map(self._name, records))
        for kind in records:
            self._register(kind)

    def _register(self, kind: Record) -> None:
        for _, part in kind.fields:
            if isinstance(part, Record):
                self._register(part)
        self._records.setdefault(self._name(kind), kind)

    def _name(self, kind: Record) -> str:
        return kind.name or self.translator.struct(kind).removeprefix("struct ")

    def text(self, extra_functions: str = "", prototypes: str = "", roots: Sequence[Instance] = ()) -> str:
        """The file; with `extra_functions` functions behind the kernels, which their prototypes announce."""
        functions = self.translator.text_of_functions([*roots, *self.entries.values()])
        binding = self._binding()
        views = max(1, *(self._views(kind) for kind in self._records.values()), *map(self._views_of, self.entries.values()))
        return "\n".join(
            (
                HEAD,
                used_helpers(self.translator, functions),
                self.translator.text_of_structs(functions + binding),
                self.translator.text_of_tables(),
                prototypes,
                functions,
                extra_functions,
                f"#define TR_MOST_VIEWS {views}",
                (TEMPLATES / "binding.c").read_text(encoding="utf-8"),
                binding,
            )
        )

    # Arguments

    def _views(self, kind: Kind) -> int:
        if isinstance(kind, Record):
            return sum(self._views(part) for _, part in kind.stored_fields())
        return int(isinstance(kind, ArrayOf))

    def _views_of(self, instance: Instance) -> int:
        return sum(map(self._views, instance.arguments.values()))

    def _take_code(self, kind: Kind, source: str, place: str, name: str, writes: bool) -> str:
        """The condition that an argument could be taken to a place."""
        if isinstance(kind, Scalar):
            return f"{TAKEN[kind]}({source}, &{place})"
        if isinstance(kind, Record):
            return f"fill_{self._name(kind)}(held, {source}, &{place})"
        if not isinstance(kind, ArrayOf):
            raise TypeError(f"no argument of {kind}")
        shape = ", ".join("-1" if length is LENGTH else str(length) for length in kind.shape)
        pointer, lengths = (f"{place}.at", f"&{place}.n0") if kind.lengths else (place, "NULL")
        shape_text = f'(const int64_t[]){{{shape}}}, {str(writes).lower()}, "{name}", {lengths}'
        return f"({pointer} = tr_array(held, {source}, '{LETTERS[kind.element]}', {len(kind.shape)}, {shape_text})) != NULL"

    def _binding(self) -> str:
        parts = [part for kind in self._records.values() for part in self._of_record(kind)]
        parts += [self._of_entry(name, instance) for name, instance in self.entries.items()]
        methods = [f'    {{"{name}", (PyCFunction)(void (*)(void))call_{name}, METH_FASTCALL, NULL}},' for name in self.entries]
        methods += [f'    {{"bind_{name}", bind_{name}, METH_O, NULL}},' for name in sorted(self._given)]
        constants = "".join(f'    PyModule_AddStringConstant(made, "{k}", "{v}");\n' for k, v in self._constants.items())
        parts.append(
            "static PyMethodDef tr_methods[] = {\n" + "\n".join(methods) + "\n    {NULL, NULL, 0, NULL},\n};\n\n"
            f'static struct PyModuleDef tr_module = {{PyModuleDef_HEAD_INIT, "{self._module}", NULL, -1, tr_methods,'
            " NULL, NULL, NULL, NULL};\n\n"
            f"PyMODINIT_FUNC PyInit_{self._module}(void)\n{{\n    PyObject *made = PyModule_Create(&tr_module);\n"
            f"    if (made == NULL) {{\n        return NULL;\n    }}\n{constants}    return made;\n}}\n"
        )
        return "\n".join(parts)

    def _of_record(self, kind: Record) -> Iterator[str]:
        """Functions that fill the struct from a tuple, read it from a tuple or a bound record, and bind it."""
        name, struct = self._name(kind), self.translator.struct(kind)
        conditions = [f'tr_is_record(given, {len(kind.fields)}, "{name}")']
        for place, (field, part) in enumerate(kind.fields):
            source = f"PyTuple_GetItem(given, {place})"
            conditions.append(self._take_code(part, source, f"found->{safe_name(field)}", f"{name}.{field}", False))
        holder = "held" if self._views(kind) else "Py_UNUSED(held)"
        yield (
            f"static bool fill_{name}(struct tr_held *{holder}, PyObject *given, {struct} *found)\n{{\n    return "
            + "\n        && ".join(conditions)
            + ";\n}\n"
        )
        if name not in self._given:
            return
        yield (
            f"struct bound_{name} {{\n    struct tr_held held;\n    {struct} found;\n}};\n\n"
            f"static const {struct} *take_{name}(struct tr_held *held, PyObject *given, {struct} *here)\n{{\n"
            "    if (PyCapsule_CheckExact(given)) {\n"
            f'        const struct bound_{name} *bound = PyCapsule_GetPointer(given, "{name}");\n'
            "        return bound == NULL ? NULL : &bound->found;\n    }\n"
            f"    return fill_{name}(held, given, here) ? here : NULL;\n}}\n\n"
            f"static PyObject *bind_{name}(PyObject *Py_UNUSED(self), PyObject *given)\n{{\n"
            f"    struct bound_{name} *made = PyMem_Malloc(sizeof(struct bound_{name}));\n"
            "    if (made == NULL) {\n        return PyErr_NoMemory();\n    }\n    made->held.used = 0;\n"
            f"    PyObject *found = fill_{name}(&made->held, given, &made->found) ? "
            f'PyCapsule_New(made, "{name}", tr_free_bound) : NULL;\n'
            "    if (found == NULL) {\n        tr_release(&made->held);\n        PyMem_Free(made);\n    }\n    return found;\n}\n"
        )

    def _of_entry(self, name: str, instance: Instance) -> str:
        """The function that Python calls."""
        used = dict(instance.given)
        lines = [f"static PyObject *call_{name}(PyObject *Py_UNUSED(self), PyObject *const *given, Py_ssize_t count)", "{"]
        lines += ["    struct tr_held here, *held = &here;", "    PyObject *answer = NULL;"]
        conditions, codes = [f'tr_counted(count, {len(instance.arguments)}, "{name}")'], []
        for place, (parameter, kind) in enumerate(instance.arguments.items()):
            if parameter not in used:
                continue
            variable = f"of_{parameter}"
            if isinstance(kind, Record):
                struct = self.translator.struct(kind)
                lines += [f"    {struct} here_{parameter};", f"    const {struct} *{variable} = NULL;"]
                pointer = f"take_{self._name(kind)}(held, given[{place}], &here_{parameter})"
                conditions.append(f"({variable} = {pointer}) != NULL")
            else:
                lines.append(f"    {self.translator.declaration(kind)}{variable};")
                writes = parameter in instance.writes
                conditions.append(self._take_code(kind, f"given[{place}]", variable, f"{name}: {parameter}", writes))
            codes.append(variable)
        call = f"{instance.name}({', '.join(codes)})"
        target = "" if instance.returns is None else f"const {self.translator.declaration(instance.returns)}found = "
        lines += ["    here.used = 0;", f"    if ({chr(10).join(conditions).replace(chr(10), chr(10) + '        && ')}) {{"]
        lines += ["        PyThreadState *state = PyEval_SaveThread();", f"        {target}{call};"]
        lines += ["        PyEval_RestoreThread(state);", f"        answer = {self._answer_code(instance.returns)};", "    }"]
        return "\n".join([*lines, "    tr_release(held);", "    return answer;", "}", ""])

    def _answer_code(self, kind: Kind | None) -> str:
        if kind is None or isinstance(kind, Const):
            return "Py_NewRef(Py_None)"
        if isinstance(kind, Scalar):
            return GIVEN_BACK[kind].format("found")
        if isinstance(kind, Record) and all(isinstance(part, Scalar) for _, part in kind.fields):
            parts = [GIVEN_BACK[part].format(f"found.{name}") for name, part in kind.stored_fields() if isinstance(part, Scalar)]
            return f'Py_BuildValue("({"N" * len(parts)})", {", ".join(parts)})'
        raise TypeError(f"no entry gives back {kind}")


def used_helpers(translator: Translator, functions: str) -> str:
    """Those of the file's own functions that others call."""
    values = {
        "REAL": translator.number(REAL),
        "REAL_LEAST": translator.literal(-LARGEST_WHOLE),
        "REAL_MOST": translator.literal(LARGEST_WHOLE),
        "FLOOR": translator.call("floor"),
        "HALF": translator.literal(0.5),
        "FMOD": translator.call("fmod"),
    }
    blocks = []
    for block in fill_template((TEMPLATES / "helpers.c").read_text(encoding="utf-8"), values).split("\n\n"):
        name = re.search(r"(tr_\w+)\(", block)
        if name and f"{name[1]}(" in functions:
            blocks.append(block.strip("\n"))
    return "\n\n".join(blocks) + "\n"


def fill_template(template: str, values: Mapping[str, str]) -> str:
    """A template with its places filled."""
    return re.sub(r"@([A-Z_]+)@", lambda match: values.get(match[1], match[0]), template)
