# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figures 6, 10, 11 and 16: a wheel's contact, strain round the loop by component, the cycles that rainflow counts in
it, and the moduli of the compound.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from proofs.reproduce.bench import (
    FAILS,
    HOLDS,
    IN_PART,
    INK,
    Bench,
    Claim,
    Figure,
    Section,
    Table,
    listed,
    percent,
    percents,
    span,
    write_csv,
)
from trackres_ros.arrays import Array
from trackres_ros.model.belt import along_belt, axial_stiffness, through_thickness
from trackres_ros.model.contact import contact_force, half_length_for_force, largest_strain
from trackres_ros.model.hysteresis import LossForce, RainflowCount
from trackres_ros.model.operating_point import explain
from trackres_ros.model.rubber import RubberModel
from trackres_ros.model.track import TrackModel, steady_tension, track_model
from trackres_ros.output.style import BLACK, BLUE, GREEN, GREY, ORANGE, PALETTE, VERMILION, picture
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MODULUS_PA = 40e6  # the paper's, section 2.4.1
WHEEL_RADIUS = 0.13  # m, half the paper's diameter
PAPER_LOADS_N = np.asarray(np.arange(1, 6) * 1e3, np.float64)
SEARCH_PARTS = 1000  # equation (11): a = j R / 1000
SEARCH_TOLERANCE = 0.01  # and stops within 1 % of the load


@dataclass(frozen=True, eq=False)
class Contact:
    """Half length [m] and largest strain of the contact under wheel loads [N], each of shape (n,)."""

    load: Array
    half_length: Array
    strain: Array

    @classmethod
    def under(cls, load: Array, length: float, thickness: float) -> Contact:
        """Of a belt of a thickness [m], on an axial length [m]."""
        half_length = half_length_for_force(load, MODULUS_PA, WHEEL_RADIUS, length, thickness)
        return cls(load, half_length, largest_strain(half_length, WHEEL_RADIUS, thickness))


def search_error(load_n: float, length: float, thickness: float) -> float:
    """Smallest relative error of the load that any step of the paper's search, equation (11), comes to."""
    a = np.arange(1, SEARCH_PARTS) * WHEEL_RADIUS / SEARCH_PARTS
    return float(np.min(np.abs(contact_force(a, MODULUS_PA, WHEEL_RADIUS, length, thickness) / load_n - 1.0)))


def indentation(bench: Bench, out: Path) -> Section:
    """The figure, and the claim that both grow with the load."""
    track = next(iter(bench.vehicle.tracks.values()))
    length, thickness = track.road_wheels.contact_length, track.belt.thickness
    curve = Contact.under(np.linspace(PAPER_LOADS_N[0], PAPER_LOADS_N[-1], 81), length, thickness)
    paper = Contact.under(PAPER_LOADS_N, length, thickness)
    figure = Figure(
        "fig06_indentation.png",
        ("fig06_indentation.csv",),
        "Contact half length and strain amplitude of a road wheel against its load (the paper's Figure 6).",
    )
    write_csv(out / figure.data[0], {"wheel_load_n": curve.load, "half_length_m": curve.half_length, "strain": curve.strain})
    _draw_contact(out / figure.png, curve, paper, f"belt {thickness * 1e3:g} mm, contact {length:g} m wide")
    at_loads, strain_at = paper.half_length, paper.strain
    growth = [float(np.log(y[-1] / y[0]) / np.log(PAPER_LOADS_N[-1] / PAPER_LOADS_N[0])) for y in (at_loads, strain_at)]
    errors = [search_error(n, length, thickness) for n in PAPER_LOADS_N]
    missed = [f"{n / 1e3:g} kN" for n, error in zip(PAPER_LOADS_N, errors, strict=True) if error >= SEARCH_TOLERANCE]
    claim = Claim(
        "contact_grows_with_load",
        "section 2.4.1, Figure 6",
        "Contact length and strain amplitude of the road wheel increase with the load.",
        {"": bool((np.diff(curve.half_length) > 0).all() and (np.diff(curve.strain) > 0).all())},
        f"From {PAPER_LOADS_N[0] / 1e3:g} to {PAPER_LOADS_N[-1] / 1e3:g} kN the half length goes from {at_loads[0] * 1e3:.2f} to "
        f"{at_loads[-1] * 1e3:.2f} mm and the strain from {strain_at[0] * 100:.2f} to {strain_at[-1] * 100:.2f} %. They grow "
        f"as the load to the power {growth[0]:.3f} and {growth[1]:.3f}.",
        {
            HOLDS: "A contact carries F = 2 E L a³ / (3 R H) as long as it is small against the wheel. So a grows as the cube "
            "root of the load and the strain, a²/(2 R H), as the square of a."
        },
        {"half_length_m": at_loads.tolist(), "strain": strain_at.tolist(),
         "exponent_half_length": growth[0], "exponent_strain": growth[1]},
    )  # fmt: skip
    ended = "It meets every load."
    if missed:
        nearest = listed([percent(e) for e in errors if e >= SEARCH_TOLERANCE])
        ended = f"At {listed(missed)} no step comes that near (nearest: {nearest}), so the search would not end."
    text = [
        f"The paper names modulus, wheel and loads. Belt thickness ({thickness * 1e3:g} mm) and axial contact length "
        f"({length:g} m) are assumed. The paper's search for the half length, equation (11), steps by R/{SEARCH_PARTS} and stops "
        f"within {percent(SEARCH_TOLERANCE, 0)} of the load. {ended}",
    ]
    return Section("Figure 6: contact of a road wheel", text, [figure], [claim], numbers={"search_error": errors})


def _draw_contact(path: Path, curve: Contact, paper: Contact, belt: str) -> None:
    with picture(path, 6.5, 3.6) as drawing:
        remainder = drawing.subplots()
        right = remainder.twinx()
        right.spines["right"].set_visible(True)
        right.grid(visible=False)
        remainder.plot(curve.load / 1e3, curve.half_length * 1e3, color=BLUE)
        remainder.plot(paper.load / 1e3, paper.half_length * 1e3, "o", color=BLUE, markersize=5)
        right.plot(curve.load / 1e3, curve.strain * 100, color=VERMILION, linestyle="--")
        right.plot(paper.load / 1e3, paper.strain * 100, "s", color=VERMILION, markersize=5)
        remainder.set_xlabel("wheel load [kN]")
        remainder.set_ylabel("contact half length [mm]", color=BLUE)
        right.set_ylabel("strain amplitude [%]", color=VERMILION)
        remainder.set_ylim(0.0, 1.08e3 * curve.half_length[-1])
        right.set_ylim(0.0, 130 * curve.strain[-1])
        remainder.set_xticks(paper.load / 1e3)
        remainder.set_title(f"E = {MODULUS_PA / 1e6:g} MPa, wheel diameter {2 * WHEEL_RADIUS:g} m, {belt}")


SPEED_KMH = 30.0  # the middle one of the paper's tests
BELT_DEGC = 40.0  # about where the belt is after ten minutes of it
POSITIONS = 961
HEIGHTS = 36
ALIKE = 0.02  # ranges nearer to each other are one line in the picture


class Spectrum(NamedTuple):
    """Strains at one operating point; `along` is of shape (heights, positions), the others (positions,)."""

    position: Array
    height: Array
    through: Array
    bending: Array
    along: Array
    tension: float
    drive: Array
    counter: RainflowCount
    half_lengths: Array
    drive_strain: float


def spectrum_at(model: TrackModel, speed: float, belt_degc: float, load: float, drive_torque: float) -> Spectrum:
    """Strains round the loop at a speed [m/s], belt temperature [degC], assembly load [N] and sprocket torque [Nm]."""
    counter, belt = RainflowCount(model.track, model.rubber), model.track.belt
    half = np.asarray(counter.contacts(speed, belt_degc, load).half_length)
    stiffness = float(axial_stiffness(belt, model.rubber.dynamic_modulus(speed / belt.loop_length, belt_degc)))
    tension = steady_tension(model, belt_degc, speed) / stiffness
    drive_strain = float(counter.drive_strain(speed, belt_degc, drive_torque))
    position = np.linspace(0.0, belt.loop_length, POSITIONS)
    height = np.linspace(0.0, belt.thickness, HEIGHTS)
    return Spectrum(
        position,
        height,
        through_thickness(counter.loop, half, position),
        (belt.thickness - belt.cord_height) * counter.loop.curvature.values_at(position),
        along_belt(counter.loop, height[:, np.newaxis], position, tension, drive_strain),
        tension,
        drive_strain * counter.loop.drive.values_at(position),
        counter,
        half,
        drive_strain,
    )


def spectrum(bench: Bench, out: Path) -> Section:
    """Both figures, and the share of each component in the loss."""
    vehicle = bench.vehicle
    speed = SPEED_KMH / KMH_PER_MPS
    point = explain(vehicle, speed, BELT_DEGC)
    model = track_model(vehicle, vehicle.assemblies[0].track)
    load = float(vehicle.nominal_loads()[0])
    drive_torque = point["torque_nm"]["resistance"] * load / vehicle.weight
    strains = spectrum_at(model, speed, BELT_DEGC, load, drive_torque)
    figures = [_spectrum_figure(out, strains), _rainflow_figure(out, strains)]
    losses = {
        "spectral": model.loss.loss_force(speed, BELT_DEGC, load, drive_torque),
        "rainflow": strains.counter.loss_force(speed, BELT_DEGC, load, drive_torque),
    }
    ranges = {
        "indentation": float(strains.through.max()),
        "bending": float(np.ptp(strains.bending)),
        "drive": float(np.ptp(strains.drive)),
    }
    text = [
        f"One assembly at {SPEED_KMH:g} km/h, {load / 1e3:g} kN and a belt of {BELT_DEGC:g} °C, all assumed. The paper gives no "
        "operating point, so only the composition can be compared. Indentation strains the belt through its thickness; bending, "
        f"tension and drive strain it along. The steady tension strains it by {strains.tension * 1e6:.0f} µm/m all round.",
    ]
    tension_loss = max(float(loss.tension) for loss in losses.values())
    bending = percents(float(loss.bending / loss.total) for loss in losses.values())
    total = span(float(loss.total) for loss in losses.values())
    claim = Claim(
        "tension_in_spectrum",
        "sections 2.4.2 and 2.4.5",
        "The strain load spectrum is built from indentation, tension, bending and driving; its cycles make the heat.",
        {**{name: value > 0 for name, value in ranges.items()}, "tension": tension_loss > 0},
        f"Ranges round the loop: indentation {percent(ranges['indentation'])}, bending {percent(ranges['bending'])} at the outer "
        f"face, drive {ranges['drive'] * 1e6:.0f} µm/m, tension 0. The loss is {total} N, of which bending has {bending} and "
        f"tension {tension_loss:g}.",
        {
            IN_PART: "A steady tension shifts the mean of the cycles and has no range, so it makes no heat.",
            HOLDS: "Every component has a range round the loop.",
            FAILS: "No component has a range round the loop.",
        },
        {"range": ranges, "tension_strain": strains.tension},
    )
    numbers = {
        "speed_kmh": SPEED_KMH,
        "belt_degc": BELT_DEGC,
        "load_n": load,
        "drive_torque_nm": drive_torque,
        "loss_force_n": {name: {k: float(v) for k, v in loss._asdict().items()} for name, loss in losses.items()},
    }
    return Section("Figures 10 and 11: strain round the loop", text, figures, [claim], [_loss_table(losses)], numbers)


def _loss_table(losses: dict[str, LossForce]) -> Table:
    parts = ("indentation", "bending", "tension", "drive")
    rows = []
    for name, loss in losses.items():
        values = [float(getattr(loss, part)) for part in parts]
        shares = [percent(value / float(loss.total), 2) for value in values]
        cells = [f"{value:.2f} ({share})" for value, share in zip(values, shares, strict=True)]
        rows.append([name, *cells, f"{float(loss.total):.2f}"])
    return Table(
        "Loss per metre of travel [N] of one assembly by cause, and its share. `drive` is what the drive torque adds, "
        "with its coupling to bending.",
        ["method", *parts, "total"],
        rows,
    )


def _spectrum_figure(out: Path, s: Spectrum) -> Figure:
    figure = Figure(
        "fig10_spectrum.png",
        ("fig10_spectrum.csv",),
        "Strain load spectrum round the loop, by component (the paper's Figure 10). It is shown through the thickness, along the "
        "belt at three heights and over position and height, and the small parts by tension and drive.",
    )
    belt = s.counter.track.belt
    cord = int(np.argmin(np.abs(s.height - belt.cord_height)))
    write_csv(
        out / figure.data[0],
        {
            "position_m": s.position,
            "through_thickness": s.through,
            "bending_outer": s.bending,
            "tension": np.full_like(s.position, s.tension),
            "drive": s.drive,
            "along_inner": s.along[0],
            "along_cord": s.along[cord],
            "along_outer": s.along[-1],
        },
    )
    with picture(out / figure.png, 9.0, 8.2) as drawing:
        through, along, field, small = drawing.subplots(4, 1, sharex=True, height_ratios=(1.0, 1.4, 1.1, 0.9))
        _draw_through(through, s)
        _draw_along(along, s, cord)
        _draw_field(field, s)
        _draw_small(small, s)
        for axes in (through, along, small):
            for start, end, _ in s.counter.loop.arcs:
                axes.axvspan(start, end, color="#F2F2F2", zorder=0)
        _name_wheels(through, along, s)
    return figure


def _draw_through(axes: Axes, s: Spectrum) -> None:
    axes.plot(s.position, 100 * s.through, color=BLUE)
    axes.set_title(f"through the thickness: indentation under road wheels 1 to {len(s.half_lengths)}")
    axes.set_ylabel("strain [%]")


def _draw_along(axes: Axes, s: Spectrum, cord: int) -> None:
    for row, label, colour in ((-1, "outer face", VERMILION), (cord, "at the cord", GREEN), (0, "inner face", ORANGE)):
        axes.plot(s.position, 100 * s.along[row], color=colour, label=label)
    axes.set_title("along the belt: bending, tension and drive together")
    axes.set_ylabel("strain [%]")
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)


def _draw_field(axes: Axes, s: Spectrum) -> None:
    cord_mm, limit = 1e3 * s.counter.track.belt.cord_height, 100 * float(np.abs(s.along).max())
    mesh = axes.pcolormesh(s.position, 1e3 * s.height, 100 * s.along, cmap="RdBu_r", vmin=-limit, vmax=limit, shading="gouraud")
    axes.axhline(cord_mm, color=INK, linewidth=0.8, linestyle="--")
    axes.annotate("cord", (0.02, cord_mm), xytext=(0, 3), textcoords="offset points", fontsize=8, color=INK)
    axes.set_title("along the belt, over position and height")
    axes.set_ylabel("height [mm]")
    axes.grid(visible=False)
    axes.figure.colorbar(mesh, cax=axes.inset_axes((1.01, 0.0, 0.015, 1.0)), label="strain [%]")


def _draw_small(axes: Axes, s: Spectrum) -> None:
    axes.plot(s.position, 1e6 * np.full_like(s.position, s.tension), color=GREY, label="tension")
    axes.plot(s.position, 1e6 * s.drive, color=BLACK, label="drive")
    axes.set_title("along the belt: the parts by tension and drive")
    axes.set_ylabel("strain [µm/m]")
    axes.set_ylim(0.0)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0)
    axes.set_xlabel("position along the loop from the front end of the ground run [m]")
    axes.set_xlim(0.0, s.position[-1])


def _name_wheels(through: Axes, along: Axes, s: Spectrum) -> None:
    loop, top = s.counter.loop, float(along.get_ylim()[1])
    along.set_ylim(top=1.2 * top)
    for (start, end, _), wheel in zip(loop.arcs, loop.track.wrapped_wheels, strict=True):
        name = wheel.name.replace("_", " ")
        along.annotate(name, ((start + end) / 2, 1.17 * top), ha="center", va="top", fontsize=8, color=INK)
    highest = float(s.through.max())
    through.set_ylim(0.0, 100 * 1.25 * highest)
    for number, x in enumerate(loop.wheel_positions, 1):
        through.annotate(f"{number}", (x, 100 * 1.03 * highest), ha="center", va="bottom", fontsize=8, color=INK)


def _rainflow_figure(out: Path, s: Spectrum) -> Figure:
    figure = Figure(
        "fig11_rainflow.png",
        ("fig11_rainflow.csv",),
        "Strain rainflow matrix of one loop (the paper's Figure 11): range, mean and count of each cycle, those "
        "along the belt at every height.",
    )
    rows = [
        ("through", np.nan, c.cycle.range, c.cycle.mean, c.cycle.number) for c in s.counter.indentation_cycles(s.half_lengths)
    ]
    for height in s.height:
        cycles = [c.cycle for c in s.counter.along_cycles(float(height), s.drive_strain, s.tension)]
        for cycle in sorted(cycles, key=lambda c: -c.range):
            rows.append(("along", float(height), cycle.range, cycle.mean, cycle.number))
    names = ("component", "height_m", "range", "mean", "count")
    write_csv(out / figure.data[0], {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)})
    data = np.array([row[1:] for row in rows], dtype=float)
    along = np.isfinite(data[:, 0])
    with picture(out / figure.png, 9.0, 4.0) as drawing:
        remainder, right = drawing.subplots(1, 2, width_ratios=(1.3, 1.0))
        distinct, counts = _counted(data[~along, 1:])
        height_mm, size, mean = 1e3 * data[along, 0], 100 * data[along, 1], 100 * data[along, 2]
        remainder.scatter(size, mean, c=height_mm, cmap="cividis", s=16, label="along the belt, by height")
        remainder.scatter(
            100 * distinct[:, 0], 100 * distinct[:, 1], marker="D", color=VERMILION, s=45, label="through the thickness"
        )
        for (x, y), count in zip(100 * distinct, counts, strict=True):
            remainder.annotate(
                f"{count:g} per loop", (x, y), xytext=(-8, -3), textcoords="offset points", ha="right", fontsize=8, color=INK
            )
        remainder.set_xlabel("strain range [%]")
        remainder.set_ylabel("strain mean [%]")
        remainder.set_title("range and mean")
        remainder.legend(loc="center right")
        bar = drawing.colorbar(remainder.collections[0], ax=remainder, pad=0.01)
        bar.set_label("height above the inner face [mm]")
        right.set_title("along the belt: range by height")
        kinds = [_alike(data[along & (data[:, 0] == height), 1:]) for height in s.height]
        for rank, (_, count) in enumerate(kinds[-1]):
            ranges = [kind[rank][0] if len(kind) == len(kinds[-1]) else np.nan for kind in kinds]
            right.plot(100 * np.array(ranges), 1e3 * s.height, color=PALETTE[rank % len(PALETTE)], label=f"{count:g} per loop")
        right.legend(loc="lower right")
        right.set_xlabel("strain range [%]")
        right.set_ylabel("height above the inner face [mm]")
    return figure


def _alike(cycles: Array) -> list[tuple[float, float]]:
    """Rows (range, mean, count) whose ranges differ by less than `ALIKE` as one: (range, sum of counts), largest first."""
    kinds: list[tuple[float, float]] = []
    for size, _, count in sorted(cycles.tolist(), reverse=True):
        if kinds and size > (1.0 - ALIKE) * kinds[-1][0]:
            kinds[-1] = (kinds[-1][0], kinds[-1][1] + count)
        else:
            kinds.append((size, count))
    return kinds


def _counted(pairs: Array) -> tuple[Array, Array]:
    """Distinct (range, mean) pairs of rows (range, mean, count), and the sum of their counts."""
    distinct, group = np.unique(pairs[:, :2].round(9), axis=0, return_inverse=True)
    return distinct, np.bincount(np.ravel(group), weights=pairs[:, 2]).astype(float)


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
        is_inside = (equivalent > rubber.sweep_degc[0]) & (equivalent < rubber.sweep_degc[-1])
        master_storage, master_loss = (
            np.where(is_inside, modulus(10.0**log_f, MASTER_DEGC), np.nan)
            for modulus in (model.storage_modulus, model.loss_modulus)
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
        ("fig16_moduli.csv", "fig16_master.csv"),
        f"Storage modulus, loss modulus and loss tangent at {frequency:g} Hz (the paper's Figure 16), and the master curve at "
        f"{MASTER_DEGC:g} °C (equations 3 and 4). Dots: the sweep of the vehicle's rubber file.",
    )
    curves.write(out)
    _draw_moduli(out / figure.png, curves, lowest, highest)
    text = [
        "The paper's measured sweep is a picture without numbers. Every torque on this page rests on the vehicle's rubber file, "
        "a representative curve of the same recipe."
    ]
    numbers = {"lowest_hz": lowest, "highest_hz": highest}
    return Section("Figure 16: the compound", text, [figure], [_modulus_claim(curves)], [_modulus_table(curves)], numbers)


def _draw_moduli(path: Path, curves: Curves, lowest: float, highest: float) -> None:
    """Moduli over temperature and frequency, with the frequencies from the loop to the contact [Hz] shaded."""
    rubber = curves.model.rubber
    shown = (
        (curves.belt_degc, curves.storage, curves.loss),
        (curves.frequency, curves.master_storage, curves.master_loss),
    )
    with picture(path, 9.0, 5.4) as drawing:
        panels = drawing.subplots(2, 2, sharex="col", sharey="row", height_ratios=(1.7, 1.0))
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
        remark, place = f"loop to contact,\n{SPEEDS_KMH[0]:g} to {SPEEDS_KMH[1]:g} km/h", (np.sqrt(lowest * highest), 0.95)
        panels[1, 1].annotate(remark, place, xycoords=("data", "axes fraction"), ha="center", va="top", fontsize=8, color=INK)


def _loss_mpa(model: RubberModel) -> dict[float, float]:
    """Loss modulus at the frequency of the sweep by temperature [degC]."""
    return {t: float(model.loss_modulus(model.rubber.sweep_frequency, t)) / 1e6 for t in SHOWN_DEGC}


def _modulus_claim(curves: Curves) -> Claim:
    model = curves.model
    frequency, moduli = model.rubber.sweep_frequency, _loss_mpa(model)
    working = (curves.belt_degc >= WORKING_DEGC[0]) & (curves.belt_degc <= WORKING_DEGC[1])
    by_decade = float(model.loss_modulus(10.0 * frequency, MASTER_DEGC) / model.loss_modulus(frequency, MASTER_DEGC))
    peak = float(curves.belt_degc[np.argmax(curves.loss)])
    return Claim(
        "loss_modulus_falls",
        "section 4.2.3, conclusions 1 and 4",
        "The loss modulus is large at low temperature and falls as the belt warms.",
        {"": bool((np.diff(curves.loss[working]) < 0).all())},
        f"At {frequency:g} Hz the loss modulus goes from {moduli[SHOWN_DEGC[0]]:.2f} MPa at {SHOWN_DEGC[0]:g} °C to "
        f"{moduli[15.0]:.2f} at 15 °C and {moduli[SHOWN_DEGC[-1]]:.2f} at {SHOWN_DEGC[-1]:g} °C. It rises nowhere "
        f"between. A decade of frequency changes it by a factor {by_decade:.2f} at {MASTER_DEGC:g} °C.",
        {
            HOLDS: f"The compound works above its glass transition: its loss modulus is largest at {peak:.0f} °C.",
            FAILS: "Part of the working range lies below the peak of the loss modulus.",
        },
        {"loss_modulus_mpa": moduli, "factor_per_decade": by_decade, "peak_degc": peak},
    )


def _modulus_table(curves: Curves) -> Table:
    model = curves.model
    frequency, moduli = model.rubber.sweep_frequency, _loss_mpa(model)
    storage = {t: float(model.storage_modulus(frequency, t)) for t in SHOWN_DEGC}
    rows = [[f"{t:g}", f"{e / 1e6:.2f}", f"{moduli[t]:.2f}", f"{moduli[t] * 1e6 / e:.3f}"] for t, e in storage.items()]
    return Table(f"Moduli of the compound at {frequency:g} Hz.", ["°C", "E′ [MPa]", "E″ [MPa]", "tan δ"], rows)
