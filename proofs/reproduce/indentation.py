# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Reproduces Figure 6: contact half length and strain amplitude against wheel load."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from proofs.reproduce.bench import Array, Bench
from proofs.reproduce.section import HOLDS, Claim, Figure, Section, listed, percent, write_csv
from trackres_ros.model.contact import contact_force, half_length_for_force, largest_strain
from trackres_ros.output.style import BLUE, VERMILION, picture

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
        "fig06_indentation.csv",
        "Contact half length and strain amplitude of a road wheel against its load (the paper's Figure 6).",
    )
    write_csv(out / figure.csv, {"wheel_load_n": curve.load, "half_length_m": curve.half_length, "strain": curve.strain})
    _draw(out / figure.png, curve, paper, f"belt {thickness * 1e3:g} mm, contact {length:g} m wide")
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
    ended = "Here every load is met."
    if missed:
        nearest = listed([percent(e) for e in errors if e >= SEARCH_TOLERANCE])
        ended = f"Here no step comes that near at {listed(missed)} (nearest: {nearest}): the search would not end."
    text = [
        f"The paper names the modulus, the wheel and the loads. Belt thickness ({thickness * 1e3:g} mm) and axial contact "
        f"length ({length:g} m) are those of the vehicle file, which assumes them.",
        f"The paper's own search for the half length (11) steps by R/{SEARCH_PARTS} and stops within "
        f"{percent(SEARCH_TOLERANCE, 0)} of the load. {ended}",
    ]
    return Section("Figure 6: contact of a road wheel", text, [figure], [claim], numbers={"search_error": errors})


def _draw(path: Path, curve: Contact, paper: Contact, belt: str) -> None:
    with picture(path, 6.5, 3.6) as drawn:
        left = drawn.subplots()
        right = left.twinx()
        right.spines["right"].set_visible(True)
        right.grid(visible=False)
        left.plot(curve.load / 1e3, curve.half_length * 1e3, color=BLUE)
        left.plot(paper.load / 1e3, paper.half_length * 1e3, "o", color=BLUE, markersize=5)
        right.plot(curve.load / 1e3, curve.strain * 100, color=VERMILION, linestyle="--")
        right.plot(paper.load / 1e3, paper.strain * 100, "s", color=VERMILION, markersize=5)
        left.set_xlabel("wheel load [kN]")
        left.set_ylabel("contact half length [mm]", color=BLUE)
        right.set_ylabel("strain amplitude [%]", color=VERMILION)
        left.set_ylim(0.0, 1.08e3 * curve.half_length[-1])
        right.set_ylim(0.0, 130 * curve.strain[-1])
        left.set_xticks(paper.load / 1e3)
        left.set_title(f"E = {MODULUS_PA / 1e6:g} MPa, wheel diameter {2 * WHEEL_RADIUS:g} m, {belt}")
