# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""One drive as MDF, CAN log, MATLAB and Excel file, each read with a line of a topics file, all with the same torque."""

from pathlib import Path

import can
import cantools
import h5py
import numpy as np
from asammdf import MDF, Signal
from openpyxl import Workbook
from scipy.io import savemat

import trackres_ros as tr

time_s = np.arange(0.0, 60.0, 0.02)
speed_kmh = np.round(10.0 * np.sin(time_s / 20.0) ** 2, 2)

with MDF() as mdf:
    mdf.append([Signal(speed_kmh, time_s, name="VehSpd", unit="km/h")], acq_name="20 ms")
    mdf.save("drive.mf4", overwrite=True)

Path("bus.dbc").write_text(
    'VERSION ""\nBS_:\nBU_: Ecu\nBO_ 256 Motion: 8 Ecu\n SG_ VehSpd : 0|16@1+ (0.01,0) [0|655] "km/h" Ecu\n', encoding="ascii"
)
motion = cantools.database.load_file("bus.dbc").get_message_by_name("Motion")
with can.Logger("drive.blf") as log:
    for t, v in zip(time_s, speed_kmh, strict=True):
        log(can.Message(timestamp=1.7e9 + t, arbitration_id=256, is_extended_id=False, data=motion.encode({"VehSpd": v})))

savemat("drive.mat", {"run": {"t": time_s, "VehSpd": speed_kmh}})
with h5py.File("drive_7_3.mat", "w") as file:  # what MATLAB saves with -v7.3 is one of HDF5 too
    file["run/t"], file["run/VehSpd"] = time_s[None, :], speed_kmh[None, :]

book = Workbook()
for row in [("time_s", "VehSpd"), *zip(time_s.tolist(), speed_kmh.tolist(), strict=True)]:
    book.active.append(row)
book.save("drive.xlsx")

of_file = {"speed": {"channel": "VehSpd"}}  # the unit is in the file
of_vector = {"speed": {"channel": "run.VehSpd", "unit": "km/h"}}
drives = {
    "drive.mf4": of_file,
    "drive.blf": {**of_file, "dbc": "bus.dbc"},
    "drive.mat": of_vector,
    "drive_7_3.mat": of_vector,
    "drive.xlsx": {"speed": {"column": "VehSpd", "unit": "km/h"}},
}
for name, topics in drives.items():
    result = tr.replay(name, "xgd24d", topics=topics)
    print(f"{name:14} {result.steps} steps, at the end {result['resistance_torque_nm'][-1]:.6f} Nm")
result.save("estimate.mf4")
