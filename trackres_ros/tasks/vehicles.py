# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Loads and checks vehicle files."""

from __future__ import annotations

from typing import TYPE_CHECKING

from trackres_ros.tasks.arguments import StrPath, VehicleGiven, as_vehicle, check_numbers

if TYPE_CHECKING:
    from trackres_ros.tasks.vehicle_check_result import VehicleCheck
    from trackres_ros.vehicle import AnyVehicle


def load_vehicle(
    vehicle: StrPath, *, method: str | None = None, thermal: str | None = None, surroundings: StrPath | None = None
) -> AnyVehicle:
    """Load a vehicle file.

    Parameters
    ----------
    vehicle
        Path of a vehicle file, or the name of a shipped vehicle such as ``xgd24d``.
    method
        Way from strain to heat instead of the file's: ``rainflow``, the paper's count, or ``spectral``, exact.
    thermal
        Thermal model instead of the file's: ``lumped`` or ``core_surface``.
    surroundings
        File of the current site, weather and ground, as a diagnosis writes it.

    Returns
    -------
    Vehicle or RoadVehicle
        Frozen and checked; SI units, temperatures in degC. A file with a section `road_load` gives a `RoadVehicle`.

    Raises
    ------
    InputError
        On a missing, unknown or implausible value: file and key, what was given and what is allowed.

    Examples
    --------
    >>> import trackres_ros as tr
    >>> vehicle = tr.load_vehicle("agri3t")
    >>> round(vehicle.weight)
    29400
    >>> tr.load_vehicle("agri3t", thermal="lumpy")
    Traceback (most recent call last):
    trackres_ros.errors.InputError: thermal: given 'lumpy'; allowed: one of lumped, core_surface; did you mean lumped?
    """
    from trackres_ros.model.track import with_methods
    from trackres_ros.vehicle import load_any, with_surroundings

    return with_surroundings(with_methods(load_any(vehicle), method, thermal), surroundings)


def check_vehicle(vehicle: VehicleGiven, *, points: int = 400) -> VehicleCheck:
    """Check a vehicle and derive wheel loads [N], masses [kg], tension [N], data coverage and table errors.

    Parameters
    ----------
    vehicle
        A vehicle, the path of its file, or the name of a shipped one.
    points
        Number of random points for comparing the loss table with the exact method.

    Returns
    -------
    VehicleCheck
        A mapping; it prints as `trackres vehicle check` does.

    Raises
    ------
    InputError
        As `load_vehicle`, and for a physically impossible value.
    """
    from trackres_ros.tasks.vehicle_check import check_vehicle
    from trackres_ros.tasks.vehicle_check_result import VehicleCheck

    check_numbers("check_vehicle", points=points)
    return VehicleCheck(check_vehicle(as_vehicle(vehicle), points))
