# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Holds the results of the estimator: one step by name, or many steps as rows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from trackres_ros.arrays import Array, IntArray
from trackres_ros.estimator import columns as at
from trackres_ros.text import decimals


class Estimate:
    """One row of results by name: torques [Nm] positive where they resist forward travel, temperatures [degC].

    Every name of `columns.columns` works as a key, `estimate["belt_degc/front_left"]`; the most used are attributes.
    """

    __slots__ = ("index", "row")

    def __init__(self, row: Array, index: Mapping[str, int]) -> None:
        self.row = row
        self.index = index

    def __getitem__(self, name: str) -> float:
        return float(self.row[self.index[name]])

    def __repr__(self) -> str:
        degrees = ", ".join(decimals(float(degc), 1) for degc in self.belt_degc())
        belts = f", belts {degrees} degC" if degrees else ""
        texts = f": {'; '.join(self.reason_texts())}" if self.reasons else ""
        return (
            f"<Estimate: resistance {decimals(self.resistance_torque_nm)} +- {decimals(self.resistance_std_nm)} Nm "
            f"at {decimals(self['speed_mps'], 2)} m/s{belts}, {self.status}{texts}>"
        )

    @property
    def resistance_torque_nm(self) -> float:
        """Hysteresis, bearings and wind, whole vehicle, at the sprockets or the driven wheels [Nm]."""
        return float(self.row[at.Results.resistance_torque_nm])

    @property
    def resistance_std_nm(self) -> float:
        """Standard deviation of the resistance torque [Nm]."""
        return float(self.row[at.Results.resistance_std_nm])

    @property
    def feedforward_torque_nm(self) -> float:
        """Chosen parts, limited in rate and size [Nm]."""
        return float(self.row[at.Results.feedforward_torque_nm])

    @property
    def reasons(self) -> at.Reason:
        """Why the status is not plainly good."""
        return at.Reason(int(self.row[at.Results.reasons]))

    @property
    def status(self) -> str:
        """`ok`, or `warn` where a reason matters to users of the torque."""
        return "warn" if self.reasons & ~at.HARMLESS else "ok"

    def reason_texts(self) -> list[str]:
        """One sentence for each reason."""
        return [text for reason, text in at.REASON_TEXT.items() if reason & self.reasons]

    def belt_degc(self) -> Array:
        """Mean belt temperature of each assembly [degC]."""
        return self._of_assemblies(at.OfAssembly.belt_degc)

    def belt_std_k(self) -> Array:
        """Standard deviation of each of them [K]."""
        return self._of_assemblies(at.OfAssembly.belt_std_k)

    def _of_assemblies(self, column: int) -> Array:
        return self.row[len(at.VEHICLE_COLUMNS) + column :: len(at.ASSEMBLY_COLUMNS)]


@dataclass(frozen=True, eq=False, repr=False)
class Steps:
    """Results of a block of messages: one row a step."""

    stamp_ns: IntArray  # (steps,), time of measurement of the speed that made the step
    arrival_ns: IntArray  # (steps,), of its logging; of one that waited in a queue, by its stamp
    rows: Array  # (steps, columns), as `Estimator.columns` names them

    def __len__(self) -> int:
        return len(self.rows)

    def __repr__(self) -> str:
        seconds = (int(self.stamp_ns[-1]) - int(self.stamp_ns[0])) * 1e-9 if len(self) else 0.0
        return f"<Steps: {len(self)} over {decimals(seconds, 1)} s>"
