"""`trackres explain`: one operating point taken apart."""

from __future__ import annotations

from typing import Any

import click

from trackres_ros.cli.common import emit, json_option, number, vehicle_option
from trackres_ros.errors import InputError
from trackres_ros.shown import decimals, figures


@click.command("explain")
@vehicle_option
@click.option("--speed-kmh", type=number(-200, 200), required=True, help="Speed [km/h]; negative in reverse.")
@click.option("--belt-degc", type=number(-60, 150), required=True, help="Belt temperature [degC].")
@click.option("--ambient-degc", type=number(-60, 60), help="Ambient temperature [degC]; default the vehicle file's.")
@click.option("--weight-kn", type=number(0.1, 1e5), help="Weight of the whole vehicle [kN]; default the vehicle file's.")
@click.option(
    "--method", type=click.Choice(["rainflow", "spectral"]), help="Way from strain to heat; default the vehicle file's."
)
@json_option
def explain_command(
    vehicle: str,
    speed_kmh: float,
    belt_degc: float,
    ambient_degc: float | None,
    weight_kn: float | None,
    method: str | None,
    as_json: bool,
) -> None:
    """Where the torque of one operating point comes from, by the exact methods.

    \b
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15
    trackres explain --vehicle xgd24d --speed-kmh 50 --belt-degc 15 --weight-kn 300 --method rainflow --json
    """
    from trackres_ros.explain import explain
    from trackres_ros.model.track import with_methods
    from trackres_ros.vehicle import load

    description = with_methods(load(vehicle), method)
    if weight_kn is not None and not 0.05 * description.weight <= weight_kn * 1e3 <= 20 * description.weight:
        raise InputError(
            "--weight-kn",
            weight_kn,
            f"{figures(0.05 * description.weight / 1e3)} to {figures(20 * description.weight / 1e3)} kN for "
            f"a vehicle of {figures(description.weight / 1e3)} kN",
        )
    result = explain(description, speed_kmh / 3.6, belt_degc, ambient_degc, None if weight_kn is None else weight_kn * 1e3)
    emit(result, as_json, lambda: _text(result))


def _text(result: dict[str, Any]) -> str:
    contact, loss, torque = result["contact"], result["loss_force_n"], result["torque_nm"]
    lines = [
        f"{result['vehicle']}: {decimals(result['speed_mps'] * 3.6, 1)} km/h, belt {decimals(result['belt_degc'], 1)} degC, "
        f"ambient {decimals(result['ambient_degc'], 1)} degC, {result['weight_n'] / 1e3:.1f} kN, {result['method']}",
        "",
        f"Road wheels of {result['assemblies'][0]}",
        f"{'':4}{'load':>9} {'half length':>12} {'strain':>8} {'frequency':>10} {'modulus':>9}",
        f"{'':4}{'N':>9} {'mm':>12} {'1':>8} {'Hz':>10} {'MPa':>9}",
    ]
    lines += [
        f"{i + 1:4d}{load:9.0f} {c['half_length_m'] * 1e3:12.2f} {c['max_strain']:8.4f} {c['frequency_hz']:10.1f} "
        f"{c['modulus_mpa']:9.2f}"
        for i, (load, c) in enumerate(zip(result["wheel_loads_n"][0], contact, strict=True))
    ]
    lines += [
        "",
        f"Belt tension {result['tension_n']:.0f} N; film coefficient {result['film_coefficient_w_m2k']:.1f} W/m2K",
        f"Loss per metre of travel of {result['assemblies'][0]} [N]: "
        + ", ".join(f"{k} {decimals(v, 1)}" for k, v in loss.items()),
        f"Heat of all belts {result['heat_w'] / 1e3:.2f} kW, cooling {decimals(result['cooling_w'] / 1e3, 2)} kW",
        "",
        "Torque at the sprockets, whole vehicle [Nm]: " + ", ".join(f"{k} {decimals(v)}" for k, v in torque.items()),
    ]
    if result["effects_left_out"]:
        lines.append(f"Left out, as they need more than an operating point: {', '.join(result['effects_left_out'])}")
    return "\n".join(lines)
