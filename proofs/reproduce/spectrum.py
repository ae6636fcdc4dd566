# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figures 10 and 11: strain of the belt round the loop by component, and the cycles that rainflow counts in it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from proofs.reproduce.bench import Array, Bench
from proofs.reproduce.section import FAILS, HOLDS, INK, Claim, Figure, Section, Table, percent, write_csv
from trackres_ros.model.belt import along_belt, axial_stiffness, through_thickness
from trackres_ros.model.hysteresis import LossForce, RainflowCount
from trackres_ros.model.operating_point import explain
from trackres_ros.model.track import TrackModel, steady_tension, track_model
from trackres_ros.output.style import BLACK, BLUE, GREEN, GREY, ORANGE, PALETTE, VERMILION, picture
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
        (belt.thickness - belt.cord_height) * counter.loop.curvature.at(position),
        along_belt(counter.loop, height[:, np.newaxis], position, tension, drive_strain),
        tension,
        drive_strain * counter.loop.drive.at(position),
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
        f"One assembly at {SPEED_KMH:g} km/h, {load / 1e3:g} kN and a belt of {BELT_DEGC:g} °C. The paper gives neither the "
        "operating point nor the numbers of its Figures 10 and 11, so only their composition can be compared. Indentation "
        "strains the belt through its thickness, bending, tension and drive along it: two components "
        "that the program counts separately.",
        f"The steady tension strains the belt by {strains.tension * 1e6:.0f} µm/m all round. The drive adds up to "
        f"{ranges['drive'] * 1e6:.0f} µm/m: {percent(ranges['drive'] / ranges['bending'], 2)} of the range of bending at the "
        "outer face.",
    ]
    tension_loss = max(float(loss.tension) for loss in losses.values())
    claim = Claim(
        "tension_in_spectrum",
        "sections 2.4.2 and 2.4.5",
        "The strain load spectrum is built from indentation, tension, bending and driving; its cycles make the heat.",
        {**{name: value > 0 for name, value in ranges.items()}, "tension": tension_loss > 0},
        f"Ranges round the loop: indentation {percent(ranges['indentation'])}, bending {percent(ranges['bending'])} at the outer "
        f"face, drive {ranges['drive'] * 1e6:.0f} µm/m, tension 0. Heat: indentation, bending and drive as in the table, tension "
        f"{tension_loss:g}.",
        {
            "holds in part": "A steady tension shifts the mean of the cycles and has no range, so it makes no heat. Its "
            "range is that of the drive force.",
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
        "fig10_spectrum.csv",
        "Strain load spectrum round the loop, by component (the paper's Figure 10). It is shown through the thickness, along the "
        "belt at three heights and over position and height, and the small parts by tension and drive.",
    )
    belt = s.counter.track.belt
    cord = int(np.argmin(np.abs(s.height - belt.cord_height)))
    write_csv(
        out / figure.csv,
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
    with picture(out / figure.png, 9.0, 8.2) as drawn:
        through, along, field, small = drawn.subplots(4, 1, sharex=True, height_ratios=(1.0, 1.4, 1.1, 0.9))
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
        "fig11_rainflow.csv",
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
    write_csv(out / figure.csv, {name: np.array(column) for name, column in zip(names, zip(*rows, strict=True), strict=True)})
    data = np.array([row[1:] for row in rows], dtype=float)
    along = np.isfinite(data[:, 0])
    with picture(out / figure.png, 9.0, 4.0) as drawn:
        left, right = drawn.subplots(1, 2, width_ratios=(1.3, 1.0))
        distinct, counts = _counted(data[~along, 1:])
        height_mm, size, mean = 1e3 * data[along, 0], 100 * data[along, 1], 100 * data[along, 2]
        left.scatter(size, mean, c=height_mm, cmap="cividis", s=16, label="along the belt, by height")
        left.scatter(100 * distinct[:, 0], 100 * distinct[:, 1], marker="D", color=VERMILION, s=45, label="through the thickness")
        for (x, y), count in zip(100 * distinct, counts, strict=True):
            left.annotate(
                f"{count:g} per loop", (x, y), xytext=(-8, -3), textcoords="offset points", ha="right", fontsize=8, color=INK
            )
        left.set_xlabel("strain range [%]")
        left.set_ylabel("strain mean [%]")
        left.set_title("range and mean")
        left.legend(loc="center right")
        bar = drawn.colorbar(left.collections[0], ax=left, pad=0.01)
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
