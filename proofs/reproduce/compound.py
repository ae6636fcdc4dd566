# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figure 16: dynamic moduli and loss tangent of the compound against temperature, and its master curve."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proofs.reproduce.bench import Array, Bench
from proofs.reproduce.section import FAILS, HOLDS, INK, Claim, Figure, Section, Table, write_csv
from trackres_ros.model.operating_point import explain
from trackres_ros.model.rubber import RubberModel
from trackres_ros.output.style import BLUE, GREEN, VERMILION, picture
from trackres_ros.units import KMH_PER_MPS

MASTER_DEGC = 20.0
MASTER_LOG_HZ = (-4.0, 12.0)
SHOWN_DEGC = (-15.0, 0.0, 15.0, 30.0, 60.0, 90.0)
WORKING_DEGC = (-15.0, 90.0)  # from the paper's coldest ambient to a hot belt
SPEEDS_KMH = (10.0, 50.0)


@dataclass(frozen=True, eq=False)
class Curves:
    """Moduli [Pa] at the frequency of the sweep over temperature [degC], and at one temperature over frequency [Hz]."""

    model: RubberModel
    belt_degc: Array
    storage: Array
    loss: Array
    frequency: Array
    master_storage: Array
    master_loss: Array

    @classmethod
    def of(cls, model: RubberModel) -> Curves:
        """Within the sweep: nan beyond it."""
        rubber = model.rubber
        belt_degc = np.linspace(rubber.sweep_degc[0], rubber.sweep_degc[-1], 421)
        storage, loss = (modulus(rubber.sweep_frequency, belt_degc) for modulus in (model.storage_modulus, model.loss_modulus))
        log_f = np.linspace(*MASTER_LOG_HZ, 321)
        equivalent = model.equivalent_temperature(log_f + model.log_shift(MASTER_DEGC))
        inside = (equivalent > rubber.sweep_degc[0]) & (equivalent < rubber.sweep_degc[-1])
        master_storage, master_loss = (
            np.where(inside, modulus(10.0**log_f, MASTER_DEGC), np.nan) for modulus in (model.storage_modulus, model.loss_modulus)
        )
        return cls(model, belt_degc, storage, loss, 10.0**log_f, master_storage, master_loss)

    def write(self, out: Path) -> None:
        """Both as CSV."""
        by_axis = (
            ("fig16_moduli.csv", "belt_degc", self.belt_degc, self.storage, self.loss),
            ("fig16_master.csv", "frequency_hz", self.frequency, self.master_storage, self.master_loss),
        )
        for name, axis, x, storage, loss in by_axis:
            write_csv(out / name, {axis: x, "storage_pa": storage, "loss_pa": loss, "tan_delta": loss / storage})


def compound(bench: Bench, out: Path) -> Section:
    """The figure, and the claim that the loss modulus falls as the belt warms."""
    frequency, curves = bench.vehicle.rubber.sweep_frequency, Curves.of(RubberModel(bench.vehicle.rubber))
    lowest = SPEEDS_KMH[0] / KMH_PER_MPS / bench.vehicle.track_of(bench.vehicle.assemblies[0]).belt.loop_length
    highest = max(c["frequency_hz"] for c in explain(bench.vehicle, SPEEDS_KMH[1] / KMH_PER_MPS, MASTER_DEGC)["contact"])
    figure = Figure(
        "fig16_compound.png",
        "fig16_moduli.csv",
        f"Storage modulus, loss modulus and loss tangent at {frequency:g} Hz (the paper's Figure 16), and the master curve at "
        f"{MASTER_DEGC:g} °C (equations 3 and 4). Dots: the sweep of the vehicle's rubber file.",
    )
    curves.write(out)
    _draw(out / figure.png, curves, lowest, highest)
    text = [
        "The paper's measured sweep is a picture without numbers. The vehicle's rubber file holds a representative curve of the "
        "same recipe, not the paper's measurement: every torque on this page rests on it. The data of the master curve are in "
        "[fig16_master.csv]({prefix}fig16_master.csv); it ends where the sweep ends."
    ]
    numbers = {"lowest_hz": lowest, "highest_hz": highest}
    return Section("Figure 16: the compound", text, [figure], [_claim(curves)], [_table(curves)], numbers)


def _draw(path: Path, curves: Curves, lowest: float, highest: float) -> None:
    """Moduli over temperature and frequency, with the frequencies from the loop to the contact [Hz] shaded."""
    rubber = curves.model.rubber
    shown = (
        (curves.belt_degc, curves.storage, curves.loss),
        (curves.frequency, curves.master_storage, curves.master_loss),
    )
    with picture(path, 9.0, 5.4) as drawn:
        panels = drawn.subplots(2, 2, sharex="col", sharey="row", height_ratios=(1.7, 1.0))
        for column, (x, e1, e2) in enumerate(shown):
            moduli, tangent = panels[0, column], panels[1, column]
            moduli.semilogy(x, e1 / 1e6, color=BLUE, label="storage modulus E′")
            moduli.semilogy(x, e2 / 1e6, color=VERMILION, label="loss modulus E″")
            tangent.plot(x, e2 / e1, color=GREEN)
        dots = panels[0, 0]
        dots.plot(rubber.sweep_degc, rubber.storage_pa / 1e6, ".", color=BLUE, markersize=4)
        dots.plot(rubber.sweep_degc, rubber.loss_pa / 1e6, ".", color=VERMILION, markersize=4)
        dots.set_title(f"at {rubber.sweep_frequency:g} Hz")
        dots.set_ylabel("modulus [MPa]")
        dots.legend(loc="upper right")
        panels[1, 0].set_ylabel("loss tangent")
        panels[1, 0].set_xlabel("temperature [°C]")
        panels[0, 1].set_title(f"master curve at {MASTER_DEGC:g} °C")
        panels[1, 1].set_xscale("log")
        panels[1, 1].set_xlabel("frequency [Hz]")
        for axes in panels[:, 1]:
            axes.axvspan(lowest, highest, color="#F2F2F2", zorder=0)
        remark, at = f"loop to contact,\n{SPEEDS_KMH[0]:g} to {SPEEDS_KMH[1]:g} km/h", (np.sqrt(lowest * highest), 0.95)
        panels[1, 1].annotate(remark, at, xycoords=("data", "axes fraction"), ha="center", va="top", fontsize=8, color=INK)


def _loss_mpa(model: RubberModel) -> dict[float, float]:
    """Loss modulus at the frequency of the sweep by temperature [degC]."""
    return {t: float(model.loss_modulus(model.rubber.sweep_frequency, t)) / 1e6 for t in SHOWN_DEGC}


def _claim(curves: Curves) -> Claim:
    model = curves.model
    frequency, at = model.rubber.sweep_frequency, _loss_mpa(model)
    working = (curves.belt_degc >= WORKING_DEGC[0]) & (curves.belt_degc <= WORKING_DEGC[1])
    by_decade = float(model.loss_modulus(10.0 * frequency, MASTER_DEGC) / model.loss_modulus(frequency, MASTER_DEGC))
    peak = float(curves.belt_degc[np.argmax(curves.loss)])
    return Claim(
        "loss_modulus_falls",
        "section 4.2.3, conclusions 1 and 4",
        "The loss modulus is large at low temperature and falls as the belt warms.",
        {"": bool((np.diff(curves.loss[working]) < 0).all())},
        f"At {frequency:g} Hz the loss modulus goes from {at[SHOWN_DEGC[0]]:.2f} MPa at {SHOWN_DEGC[0]:g} °C to {at[15.0]:.2f} "
        f"at 15 °C and {at[SHOWN_DEGC[-1]]:.2f} at {SHOWN_DEGC[-1]:g} °C. It rises nowhere between. A decade of frequency "
        f"changes it by a factor {by_decade:.2f} at {MASTER_DEGC:g} °C.",
        {
            HOLDS: f"The compound works above its glass transition (largest loss modulus at {peak:.0f} °C), where warming moves "
            "it away from the peak.",
            FAILS: "Part of the working range lies below the peak of the loss modulus.",
        },
        {"loss_modulus_mpa": at, "factor_per_decade": by_decade, "peak_degc": peak},
    )


def _table(curves: Curves) -> Table:
    model = curves.model
    frequency, at = model.rubber.sweep_frequency, _loss_mpa(model)
    storage = {t: float(model.storage_modulus(frequency, t)) for t in SHOWN_DEGC}
    rows = [[f"{t:g}", f"{e / 1e6:.2f}", f"{at[t]:.2f}", f"{at[t] * 1e6 / e:.3f}"] for t, e in storage.items()]
    return Table(f"Moduli of the compound at {frequency:g} Hz.", ["°C", "E′ [MPa]", "E″ [MPa]", "tan δ"], rows)
