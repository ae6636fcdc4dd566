# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Writes a fitted compound: a rubber file, a vehicle file that uses it, and the Prony series for other programs."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from trackres_ros.arrays import Array
from trackres_ros.errors import InputError, one_line
from trackres_ros.files.file_sets import file_set
from trackres_ros.files.output_files import not_an_input
from trackres_ros.files.own_files import write
from trackres_ros.text import figures
from trackres_ros.tools.compound.fitting import ARRHENIUS, KEPT, CompoundFit
from trackres_ros.vehicle import Vehicle, load
from trackres_ros.vehicle.description import FITTED, RUBBER
from trackres_ros.vehicle.loading import SWEEP_DEGC, SWEEP_TAN_DELTA, WARM_STORAGE
from trackres_ros.vehicle.writing.changes import FileChanges
from trackres_ros.vehicle.writing.vehicle_file import SURROUNDINGS_FILE, write_numbered, write_track_vehicle
from trackres_ros.vehicle.writing.yaml_edit import Document

ROWS_K = 2.5  # between rows of a rubber file
MOST_MEASURED_ROWS = 300
ALIKE_K = 0.05  # temperatures that differ by less are one
TWO_SIDED_95 = 1.96
SCATTER = [0.8, 1.2]  # of the loss modulus, as in the reference vehicle
SCATTER_REASON = "batch scatter and strain amplitude, which a sweep of one specimen does not determine"
LONGEST_STEM = 40
# Comment of an earlier fit at the top of the vehicle file, below that of this one.
EARLIER = re.compile(r"(?<=\n)# Written by trackres compound fit .*\n(# (Of the file|Shift|Master curve).*\n)*")
INSIDE = 1.0001  # of a limit, so that a value rounded to six figures stays inside
MODULI_HEAD = "T_degC,E_storage_MPa,E_loss_MPa,tan_delta,E_storage_low_MPa,E_storage_high_MPa,E_loss_low_MPa,E_loss_high_MPa"


def stem_of(path: Path) -> str:
    """The name of a compound, after its sweep."""
    stem = re.sub(r"[^A-Za-z0-9_-]+", "_", path.stem).strip("_")[:LONGEST_STEM]
    return stem if stem[:1].isalpha() else f"compound_{stem}".rstrip("_")


def files_of(sweep: Path, folder: Path, inputs: Iterable[Path] = ()) -> dict[str, Path]:
    """The files of a sweep, by kind. Raises InputError if one is the sweep or another input, or the folder is a diagnosis'."""
    stem = stem_of(sweep)
    content = {
        "vehicle": folder / f"{stem}.yaml",
        "rubber": folder / "rubber" / f"{stem}.csv",
        "prony": folder / f"{stem}_prony.csv",
        "picture": folder / f"{stem}.png",
    }
    for path in content.values():
        not_an_input(path, (sweep, *inputs), "output")
    if (folder / SURROUNDINGS_FILE).exists():
        raise InputError("output", f"{folder}, which has a {SURROUNDINGS_FILE}", "a folder of its own")
    return content


def write_compound(fit: CompoundFit, vehicle: Vehicle, files: dict[str, Path]) -> Vehicle:
    """Write rubber file, Prony series and vehicle file; return the vehicle as it is read back.

    Raises InputError if a vehicle may not have the compound.
    """
    put_compound(fit, vehicle, files)
    return load(files["vehicle"])


def put_compound(fit: CompoundFit, vehicle: Vehicle, files: dict[str, Path]) -> None:
    """Write rubber file, Prony series and vehicle file together. Raises InputError if a vehicle may not have the compound."""
    _check_warm(fit)
    try:
        with file_set():
            rubber = write_numbered(files["rubber"], _rubber_text(fit).encode())
            write(files["prony"], prony_text(fit).encode())
            with_rubber = replace(vehicle, name=_name(vehicle, files["vehicle"].stem), rubber_source=rubber)
            changes = FileChanges(
                None, (), {}, command="trackres compound", amend=lambda text: _with_rubber(text, with_rubber, fit)
            )
            write_track_vehicle(with_rubber, files["vehicle"], changes, "\n".join(_provenance(fit)))
    except OSError as error:
        raise InputError(
            "output", f"{error.filename or files['vehicle'].parent}: {error.strerror or error}", "a writable folder"
        ) from error


def table_degc(fit: CompoundFit) -> Array:
    """Temperatures of the rows of a rubber file: the measured ones for one frequency, else evenly spaced."""
    low, high = max(fit.master.low_degc, SWEEP_DEGC.low), min(fit.master.high_degc, SWEEP_DEGC.high)
    measured: list[float] = []
    for temp in np.unique(fit.sweep.temp_degc):
        if not measured or temp - measured[-1] > ALIKE_K:  # a ramp has smaller steps throughout
            measured.append(temp)
    if len(fit.sweep.frequencies) == 1 and len(measured) <= MOST_MEASURED_ROWS:
        return np.array(measured)
    return np.linspace(low, high, max(int(np.ceil((high - low) / ROWS_K)) + 1, 4))


def _check_warm(fit: CompoundFit) -> None:
    warmest_mpa = float(fit.master.moduli(fit.master.high_degc)[0][0]) / 1e6
    if warmest_mpa > WARM_STORAGE.high:
        raise InputError(
            str(fit.sweep.path),
            f"a sweep whose warm end, {figures(fit.master.high_degc)} degC, has a storage modulus of {figures(warmest_mpa)} MPa",
            f"a warm end where it is a rubber, at most {WARM_STORAGE.high:g} MPa",
            "extend the sweep to warmer temperatures",
        )


def _name(vehicle: Vehicle, stem: str) -> str:
    return vehicle.name if vehicle.name.endswith(f"_{stem}") else f"{vehicle.name}_{stem}"


def _provenance(fit: CompoundFit) -> list[str]:
    """Origin of the compound, line by line."""
    sweep = fit.sweep
    frequencies = sweep.frequencies
    span = (
        f"{figures(frequencies[0])} Hz"
        if len(frequencies) == 1
        else f"{figures(frequencies[0])} to {figures(frequencies[-1])} Hz"
    )
    return [
        f"Written by trackres compound fit from {one_line(sweep.path.name)}: {len(sweep.storage)} rows, "
        f"{sweep.temp_degc.min():.1f} to {sweep.temp_degc.max():.1f} degC, {span}.",
        *(f"Of the file: {one_line(note)}." for note in sweep.notes),
        f"Shift {fit.law}: {fit.why}.",
        f"Master curve at {figures(fit.master.at_frequency)} Hz: rms {_percent(fit.rms[0])} in storage, {_percent(fit.rms[1])} "
        f"in loss modulus; Prony series of both {_percent(fit.prony.rms[0])}, {_percent(fit.prony.rms[1])}.",
    ]


def _percent(share: float) -> str:
    return f"{figures(100.0 * share, 2)} %"


def _comments(lines: Iterable[str]) -> str:
    return "".join(f"# {line}\n" for line in lines)


def _rubber_text(fit: CompoundFit) -> str:
    degc = table_degc(fit)
    storage, loss = (modulus / 1e6 for modulus in fit.master.moduli(degc))
    loss = np.clip(loss, INSIDE * SWEEP_TAN_DELTA.low * storage, SWEEP_TAN_DELTA.high / INSIDE * storage)
    wide_storage, wide_loss = np.exp(TWO_SIDED_95 * fit.master.log_std(degc)).T
    limits = storage / wide_storage, storage * wide_storage, loss / wide_loss, loss * wide_loss
    rows = np.column_stack([degc, storage, loss, loss / storage, *limits])
    head = [*_provenance(fit), "low and high: 95 % intervals of the curve, of errors that differ from row to row."]
    return _comments(head) + MODULI_HEAD + "\n" + "".join(",".join(_cells(row)) + "\n" for row in rows)


def _cells(row: Sequence[float]) -> list[str]:
    return [f"{row[0]:.2f}", *(f"{x:.6g}" for x in row[1:])]


def prony_text(fit: CompoundFit) -> str:
    """The Prony series for other programs: relaxation times and strengths, below a head with their temperature and shift."""
    prony, reference = fit.prony, fit.prony.reference_degc
    c1, c2 = fit.shift.wlf(reference)
    shift_text = f"T {'+' if reference < 0.0 else '-'} {abs(reference):.6g}"
    head = [
        *_provenance(fit),
        f"Relaxation strengths in tension at {reference:.6g} degC; tau_s inf is the modulus of infinite time.",
        f"Shift of these times: log10 a_T = -{c1:.6g} ({shift_text}) / ({c2:.6g} + {shift_text}), T in degC, "
        f"above {fit.shift.glass_transition:.6g} degC, below it its tangent.",
        "low and high: 95 % intervals; strengths of 0 are left out.",
    ]
    lines = ["tau_s,E_MPa,E_low_MPa,E_high_MPa"]
    for tau, strength, std in zip(["inf", *(f"{t:.6g}" for t in prony.tau)], prony.strength, prony.std, strict=True):
        if strength > 0.0 or tau == "inf":
            reach = TWO_SIDED_95 * std
            lines.append(f"{tau},{strength / 1e6:.6g},{max(strength - reach, 0.0) / 1e6:.6g},{(strength + reach) / 1e6:.6g}")
    return _comments(head) + "\n".join(lines) + "\n"


def _with_rubber(text: str, vehicle: Vehicle, fit: CompoundFit) -> str:
    """The text of a vehicle file with the values of the compound."""
    document = Document(EARLIER.sub("", text, count=1))
    document.set(("name",), vehicle.name)
    frequency = float(f"{fit.master.at_frequency:.6g}")
    _set(
        document,
        "sweep_frequency",
        frequency,
        [frequency, frequency],
        FITTED,
        f"of the rubber file, the lowest of {one_line(fit.sweep.path.name)}",
    )
    if fit.law != KEPT:
        for name, value_found in fit.values.items():
            value, low, high = (float(f"{x:.6g}") for x in (value_found.value, value_found.low, value_found.high))
            limits = RUBBER[name]
            span = [max(min(low, value), limits.low), min(max(high, value), limits.high)]
            _set(document, name, value, span, FITTED, _reason(fit, name))
    old_quantity = vehicle.parameters["rubber.loss_modulus_scale"]
    span = (
        [old_quantity.low, old_quantity.high]
        if old_quantity.flag != FITTED and old_quantity.low <= 1.0 <= old_quantity.high
        else SCATTER
    )
    _set(document, "loss_modulus_scale", 1.0, span, "A", SCATTER_REASON)
    return document.text() or _comments(_provenance(fit)) + document.plain()


def _reason(fit: CompoundFit, name: str) -> str:
    law = "Arrhenius' law, whose C2 is its reference in kelvin" if fit.law == ARRHENIUS else "WLF"
    sweep_name = one_line(fit.sweep.path.name)
    if name == "glass_transition":
        if fit.glass_is_seen:
            return f"below it the shift of {sweep_name} is straight; fitted, 95 % interval"
        return f"reference of the shift alone: {sweep_name} does not show the bend of the shift at a glass transition"
    return f"{law} about Tg + 50 K, fitted to {sweep_name}; 95 % interval, of C1 and C2 together: they go with each other"


def _set(document: Document, name: str, value: float, span: Sequence[float], flag: str, reason: str) -> None:
    for key, new_value in {"value": value, "range": list(span), "flag": flag, "reason": reason}.items():
        document.set(("rubber", name, key), new_value)
