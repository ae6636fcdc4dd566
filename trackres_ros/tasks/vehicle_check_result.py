# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines the result of a vehicle check, for people and for programs."""

from __future__ import annotations

from html import escape

from trackres_ros.tasks.content import Content
from trackres_ros.text import figures, listed, panel
from trackres_ros.text import table as text_table


class VehicleCheck(Content):
    """A checked vehicle file; see `trackres_ros.check_vehicle`. A mapping with the content of `as_dict`."""

    @property
    def _model(self) -> str:
        return f"hysteresis {self['hysteresis']}, thermal {self['thermal']}" if "tracks" in self else "base model road_load"

    @property
    def _runs_on(self) -> str:
        return ", ".join(f"{k} {v / 1e3:.1f} kN" for k, v in self["assemblies"].items()) if "tracks" in self else "wheels"

    def __repr__(self) -> str:
        quantities = self["quantities"]
        lines = [
            f"{self['title']} ({self['file']}): all values are within their limits" + (", but:" if self["remarks"] else ""),
            *(f"  ! {remark}" for remark in self["remarks"]),
            f"  {quantities['P']} values from the paper, {quantities['L']} from literature, {quantities['A']} assumed, "
            f"{quantities['F']} fitted; " + self._model,
            *([f"  rubber of {self['rubber_file']}"] if "tracks" in self else []),
            f"  weight {self['weight_n'] / 1e3:.1f} kN on " + self._runs_on,
        ]
        if self["effects"]:
            lines.append(f"  with {', '.join(self['effects'])}")
        if "tracks" not in self:
            head = ("speed\nkm/h", "resistance\nNm", "+-\nNm", "power\nkW")
            names = {"speed_mps": 3.6, "resistance_torque_nm": 1.0, "resistance_std_nm": 1.0, "power_w": 1e-3}
            rows = [[figures(p[name] * factor) for name, factor in names.items()] for p in self["level_ground"]]
            return "\n".join([*lines, "On level ground", text_table(rows, head, indent=2)])
        for name, t in self["tracks"].items():
            table, uncertainty, data = t["table"], t["uncertainty"], t["rubber_data"]
            ends = zip(data["speed_mps"], data["coldest_degc"], strict=True)
            facts = {
                "wheel loads": ", ".join(f"{load:.0f}" for load in t["wheel_loads_n"]) + " N",
                "hinge": f"{t['hinge_position_m']:.3f} m behind the front end of the ground run",
                "belt mass": f"{t['belt_mass_kg']:.1f} kg ({t['mass_per_length_kg_m']:.2f} kg/m)",
                "heat capacity": f"{t['heat_capacity_j_k'] / 1e3:.1f} kJ/K",
                "cooled area": f"{t['cooled_area_m2']:.2f} m2",
                "axial stiffness": f"{t['axial_stiffness_n'] / 1e6:.1f} MN",
                "tension": f"{t['tension_n']:.0f} N, sag {t['sag_m'] * 1e3:.1f} mm",
                "one standard deviation of": ", ".join(f"{k} {v:.0%}" for k, v in uncertainty.items())
                + " (from the ranges in the file)",
                "loss table": f"error at most {table['largest_error']:.3%}, rms {table['rms_error']:.3%} at {table['points']} "
                f"points, loads {table['load_range_n'][0] / 1e3:.1f} to {table['load_range_n'][1] / 1e3:.1f} kN, "
                f"computed in {table['seconds']:.2f} s",
                "drive torque": f"changes the loss by at most {table['drive_torque_share']:.4%}; "
                f"forward and reverse differ by at most {table['reverse_share']:.4%}",
                "rubber data": "cover belts of "
                + ", ".join(f"{low:.0f} degC at {v * 3.6:.0f} km/h" for v, low in ends)
                + f" and warmer, to {data['hottest_degc']:.0f} degC",
                "heat": f"settles at {t['balance_degc']:.0f} degC at the greatest speed and nominal load",
            }
            lines += [f"Track {name}", text_table(facts.items(), indent=2, numbers=False)]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        head, *lines = repr(self).splitlines()
        remarks = [line.strip(" !") for line in lines if line.startswith("  !")]
        shown = [line for line in lines if not line.startswith("  !")]
        return panel(head, listed("Remarks", remarks), f"<pre>{escape(chr(10).join(shown))}</pre>")
