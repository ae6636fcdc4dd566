# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs the whole fit, from the sweep to files and summary."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from trackres_ros.checks import number
from trackres_ros.errors import one_line
from trackres_ros.files.file_sets import file_set
from trackres_ros.model.coverage import check_heat
from trackres_ros.model.loss_table import loss_table
from trackres_ros.text import alike, decimals, figures, table
from trackres_ros.tools.compound.coverage import covered, need_of
from trackres_ros.tools.compound.fitting import ARRHENIUS, KEPT, CompoundFit, fit_compound
from trackres_ros.tools.compound.picture import draw_compound
from trackres_ros.tools.compound.reading import FREQUENCIES, read_sweep
from trackres_ros.tools.compound.superposition import Value
from trackres_ros.tools.compound.writing import files_of, put_compound, write_compound
from trackres_ros.vehicle import Vehicle, load
from trackres_ros.vehicle import files_of as inputs_of
from trackres_ros.vehicle.description import RUBBER

BADLY_APART = 0.1  # of a Prony series from either modulus: a tenth of both is more than instruments are off


def fit_and_write(sweep_file: Path, vehicle_given: str, folder: Path, frequency_hz: float | None = None) -> dict[str, Any]:
    """Fit a sweep, write the compound and its picture; return the results, ready for JSON.

    Raises InputError if the sweep cannot be read, or a vehicle may not have its compound.
    """
    if frequency_hz is not None:
        number(frequency_hz, "frequency_hz", FREQUENCIES.low, FREQUENCIES.high, "Hz")
    vehicle_before = load(vehicle_given)
    files = files_of(sweep_file, folder, inputs_of(vehicle_before))
    sweep = read_sweep(sweep_file, frequency_hz)
    fit = fit_compound(sweep, vehicle_before)
    with TemporaryDirectory() as trial:
        trial_files = write_compound(fit, vehicle_before, files_of(sweep_file, Path(trial)))
        _check_belts(trial_files, sweep_file)
    need = need_of(trial_files)
    with file_set():
        put_compound(fit, vehicle_before, files)
        draw_compound(fit, need, files["picture"])
    vehicle = load(files["vehicle"])
    part = covered(fit, need)
    values = {name: _quantity(value, RUBBER[name].unit) for name, value in fit.values.items()}
    if fit.energy is not None:
        values["activation_energy"] = _quantity(fit.energy, "J/mol")
    return {
        "sweep": str(sweep_file),
        "rows": len(sweep.storage),
        "temperatures_degc": [float(sweep.temp_degc.min()), float(sweep.temp_degc.max())],
        "frequencies_hz": [float(f) for f in sweep.frequencies],
        "notes": list(sweep.notes),
        "shift": {"law": fit.law, "why": fit.why, "glass_transition_is_seen": bool(fit.glass_is_seen)},
        "values": values,
        "before": {name: getattr(vehicle_before.rubber, name) for name in fit.values},
        "vehicle": {"given": vehicle_given, "before": vehicle_before.name, "name": vehicle.name},
        "sweep_frequency_hz": fit.master.at_frequency,
        "rms": {"storage": float(fit.rms[0]), "loss": float(fit.rms[1])},
        "prony": {
            "terms": int((fit.prony.strength[1:] > 0).sum()),
            "rms_storage": float(fit.prony.rms[0]),
            "rms_loss": float(fit.prony.rms[1]),
        },
        "need": {"degc": [need.coldest, need.hottest], "hz": [need.slowest, need.fastest]},
        "covered": {"share": part.share, "text": part.sentence(need)},
        "remarks": _remarks(fit),
        "written": [str(path) for path in {**files, "rubber": vehicle.rubber_source}.values()],
    }


def _check_belts(vehicle: Vehicle, sweep_file: Path) -> None:
    """See, before anything is written, that each command takes the vehicle with this compound."""
    for name in vehicle.tracks:
        check_heat(replace(vehicle, source=sweep_file), name, loss_table(vehicle, name))


def _quantity(value: Value, unit: str) -> dict[str, Any]:
    return {"value": float(value.value), "range": [float(value.low), float(value.high)], "unit": unit}


def _remarks(fit: CompoundFit) -> list[str]:
    remarks = []
    if max(fit.prony.rms) > BADLY_APART:
        remarks.append(
            f"no Prony series has both moduli and this shift together: it is {100 * fit.prony.rms[0]:.0f} % off in storage and "
            f"{100 * fit.prony.rms[1]:.0f} % in loss modulus; strain amplitude, clamping or the shift may be the cause"
        )
    if fit.law == KEPT:
        remarks.append("to fit a shift, measure several frequencies over a factor of 10 or more at each temperature")
    if fit.power is not None and fit.with_power is not None:
        power = alike([fit.power.value, fit.power.low, fit.power.high], fit.power.high - fit.power.low)
        rms = " and ".join(f"{decimals(100.0 * x, 2)} %" for x in fit.with_power)
        remarks.append(
            f"beside the shift moduli go with absolute temperature to the power {power[0]} ({power[1]} to {power[2]}; rubber "
            f"elasticity alone: 1), of which the model has nothing: with it rms would be {rms}; the shift is that beside it, its "
            "ranges hold the shift without it too"
        )
    if fit.law == ARRHENIUS:
        remarks.append("Arrhenius' law is written as WLF with C2 = Tg + 50 K in kelvin, which is the same above Tg")
    return remarks


def found_text(fit_dict: dict[str, Any]) -> str:
    """The table for people."""
    span, hertz = fit_dict["temperatures_degc"], fit_dict["frequencies_hz"]
    of_frequencies = (
        f"{figures(hertz[0])} Hz"
        if len(hertz) == 1
        else f"{len(hertz)} frequencies, {figures(hertz[0])} to {figures(hertz[-1])} Hz"
    )
    lines = [f"{one_line(fit_dict['sweep'])}: {fit_dict['rows']} rows, {span[0]:.1f} to {span[1]:.1f} degC, {of_frequencies}"]
    lines += [f"  {note}" for note in fit_dict["notes"]]
    lines.append(f"Shift {fit_dict['shift']['law']}: {fit_dict['shift']['why']}.")
    rows, is_file_shift = [], fit_dict["shift"]["law"] == KEPT
    for name, q in fit_dict["values"].items():
        numbers = [q["value"], *q["range"]]
        texts_of_numbers = [figures(x, 4) for x in numbers] if is_file_shift else alike(numbers, numbers[2] - numbers[1])
        rows.append((name, q["unit"], *texts_of_numbers, figures(fit_dict["before"].get(name), 4)))
    rms = fit_dict["rms"], fit_dict["prony"]
    lines.append(
        table(
            rows,
            (
                "value",
                "unit",
                "kept" if is_file_shift else "fitted",
                "from",
                "to" if is_file_shift else "to (95 %)",
                fit_dict["vehicle"]["before"],
            ),
            indent=2,
            numbers=False,
        )
    )
    head = ("", "storage modulus", "loss modulus")
    percent = [
        (f"rms of the master curve at {figures(fit_dict['sweep_frequency_hz'])} Hz", rms[0]["storage"], rms[0]["loss"]),
        (f"rms of a Prony series of {rms[1]['terms']} terms", rms[1]["rms_storage"], rms[1]["rms_loss"]),
    ]
    lines.append(
        table([(text, *(f"{decimals(100.0 * x, 2)} %" for x in pair)) for text, *pair in percent], head, indent=2, numbers=False)
    )
    lines.append(fit_dict["covered"]["text"])
    lines += [f"  ! {remark}" for remark in fit_dict["remarks"]]
    lines.append(f"Written: {', '.join(fit_dict['written'])}")
    vehicle_file = fit_dict["written"][0]
    lines.append(f"Next: trackres vehicle check {vehicle_file}; trackres compare {fit_dict['vehicle']['given']} {vehicle_file}")
    return "\n".join(lines)
