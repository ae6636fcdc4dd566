# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Defines what results of tasks have in common: mappings of plain data, or of column name to array over time."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from trackres_ros.errors import MissingExtraError
from trackres_ros.files.output_files import picture_file
from trackres_ros.model.resistance import resistance_parts
from trackres_ros.output.table import unit_of
from trackres_ros.text import decimals, html_table
from trackres_ros.units import KMH_PER_MPS

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

Array = NDArray[Any]

SHOWN_ROWS = 8


class Content(Mapping[str, Any]):
    """A frozen mapping of plain data."""

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = dict(content)

    def __getitem__(self, name: str) -> Any:
        return self._content[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)

    def as_dict(self) -> dict[str, Any]:
        """The whole content, ready for JSON.

        Returns
        -------
        dict
            Plain data, with the units in the names.
        """
        return dict(self._content)


class SeriesResult(Mapping[str, Array]):
    """Results over time: a mapping of column name to an array of shape (times,) of the caller's own, the unit in the name.

    Torques are of the whole vehicle at the sprockets, positive where they resist forward travel; a column of one assembly
    ends in its name, ``belt_degc/front_left``.
    """

    title: str

    @property
    @abstractmethod
    def columns(self) -> tuple[str, ...]:
        """Names of all columns, the time first."""

    @abstractmethod
    def _attributes(self) -> dict[str, str]:
        """Name of the vehicle, for the attributes of a table."""

    @abstractmethod
    def save(self, path: str | PathLike[str]) -> Path:
        """Write to a file: `.csv`, `.csv.gz`, `.parquet` or `.mf4` as a table, `.mcap` as the topics of the live node."""

    @abstractmethod
    def _picture_series(self) -> Mapping[str, Array]:
        """The columns of the picture, which may be thinned."""

    def _coverage(self) -> Array | None:
        """Seconds used for learning, if any."""
        return None

    __eq__ = object.__eq__  # of a mapping it compares the arrays, whose truth is ambiguous
    __hash__ = object.__hash__

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def __contains__(self, name: object) -> bool:
        return name in self.columns  # also where the rows went into a file

    @property
    def time_s(self) -> Array:
        """Times from the start [s], shape (times,)."""
        return self["time_s"]

    def to_pandas(self) -> pd.DataFrame:
        """A pandas DataFrame over `time_s`, the other columns under the same names.

        Returns
        -------
        pandas.DataFrame
            Its `attrs` hold the vehicle, and under ``units`` the unit of each column.

        Raises
        ------
        MissingExtraError
            Without pandas.
        """
        try:
            import pandas as pd
        except ImportError:
            raise MissingExtraError("to_pandas", "pandas", "notebook") from None
        index = pd.Index(self.time_s, name="time_s")
        frame = pd.DataFrame({name: self[name] for name in self.columns if name != "time_s"}, index=index)
        frame.attrs.update(self._attributes(), units={name: unit_of(name) for name in self.columns})
        return frame

    def to_xarray(self) -> xr.Dataset:
        """An xarray Dataset over `time_s`, and over `assembly` for columns of assemblies; the unit is in `attrs` of each.

        ``belt_degc`` is then one variable of shape (times, assemblies). If the whole vehicle has a column of the same name,
        that of the assemblies is called ``assembly_resistance_torque_nm``.

        Returns
        -------
        xarray.Dataset
            Its `attrs` hold the vehicle.

        Raises
        ------
        MissingExtraError
            Without xarray.
        """
        try:
            import xarray as xr
        except ImportError:
            raise MissingExtraError("to_xarray", "xarray", "notebook") from None
        names = [name for name in self.columns if name != "time_s"]
        assemblies = list(dict.fromkeys(name.partition("/")[2] for name in names if "/" in name))
        variables: dict[str, Any] = {}
        for name in names:
            base, slash, _ = name.partition("/")
            attributes = {"units": unit_of(name)} if unit_of(name) else {}
            if not slash:
                variables[name] = ("time_s", self[name], attributes)
            elif (key := f"assembly_{base}" if base in names else base) not in variables:
                values = np.stack([self[f"{base}/{assembly}"] for assembly in assemblies], axis=1)
                variables[key] = (("time_s", "assembly"), values, attributes)
        coordinates: dict[str, Any] = {"time_s": ("time_s", self.time_s, {"units": "s"})}
        if assemblies:
            coordinates["assembly"] = assemblies
        return xr.Dataset(variables, coordinates, self._attributes())

    def plot(self, path: str | PathLike[str] | None = None) -> Figure:
        """Draw speed, torque by part and belt temperature over time.

        Parameters
        ----------
        path
            `.png` or `.svg` file to write too.

        Returns
        -------
        matplotlib.figure.Figure
            A notebook shows it.

        Raises
        ------
        InputError
            Another suffix, or a folder of that name.
        MissingExtraError
            Without matplotlib.
        """
        from trackres_ros.output.plots import estimate_figure

        series = self._picture_series()
        columns = {name: series[name] for name in series if name not in ("time_s", "stamp_ns")}
        picture = None if path is None else picture_file(path)
        return estimate_figure(series["time_s"], columns, self.title, self._coverage(), picture)

    def _table(self) -> str:
        """A few rows as HTML, evenly apart."""
        series = self._picture_series()
        count = len(series["time_s"])
        rows = sorted(set(np.linspace(0, count - 1, min(SHOWN_ROWS, count)).astype(int).tolist()))
        belts = [name for name in series if name.partition("/")[0] == "belt_degc"]
        torques = {"resistance": "resistance_torque_nm", "std": "resistance_std_nm", **resistance_parts(bool(belts))}
        torques = {name: column for name, column in torques.items() if column in series}

        def line(i: int) -> list[str]:
            degc = [float(series[name][i]) for name in belts]
            ends = [decimals(v, 1) for v in (min(degc), max(degc))] if degc else []
            bounds = list(dict.fromkeys(ends))
            return [
                decimals(float(series["time_s"][i]), 1),
                decimals(float(series["speed_mps"][i]) * KMH_PER_MPS, 1),
                *(decimals(float(series[column][i])) for column in torques.values()),
                *([" to ".join(bounds)] if bounds else []),
            ]

        units = ("s", "km/h", *("Nm" for _ in torques), *(["degC"] if belts else []))
        return html_table(("time", "speed", *torques, *(["belts"] if belts else [])), [line(i) for i in rows], units)
