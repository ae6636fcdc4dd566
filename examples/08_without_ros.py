# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A controller without ROS: it reads ~/estimate by Cyclone DDS, and is told by the middleware when the node falls silent.

The node runs in a process of its own, as `trackres live` does; here it is stopped for a while, as a machine that hangs. Needs
the extra dds: pip install "trackres_ros[dds]".
"""

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass

# On this machine only, and in a domain of its own.
os.environ["CYCLONEDDS_URI"] = (
    "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast><Interfaces>"
    '<NetworkInterface name="lo" multicast="false"/></Interfaces></General><Discovery><ParticipantIndex>auto</ParticipantIndex>'
    "<MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>"
    '<Peers><Peer address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
)
DOMAIN = int(os.environ.setdefault("ROS_DOMAIN_ID", "187"))

from cyclonedds.core import Listener, Policy, Qos  # noqa: E402
from cyclonedds.domain import DomainParticipant  # noqa: E402
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.types import float64, int32, sequence, uint32  # noqa: E402
from cyclonedds.pub import DataWriter  # noqa: E402
from cyclonedds.sub import DataReader  # noqa: E402
from cyclonedds.topic import Topic  # noqa: E402
from cyclonedds.util import duration  # noqa: E402

DEADLINE_S = 0.2  # what the node offers, output_deadline_s
PATIENCE_S = 120.0


# Names of types and fields as ROS 2 has them on the wire.
@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec_: int32
    nanosec_: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp_: Time
    frame_id_: str


@dataclass
class InterfaceValue(IdlStruct, typename="control_msgs::msg::dds_::InterfaceValue_"):
    interface_names_: sequence[str]
    values_: sequence[float64]


@dataclass
class Estimate(IdlStruct, typename="control_msgs::msg::dds_::DynamicInterfaceGroupValues_"):
    header_: Header
    interface_groups_: sequence[str]
    interface_values_: sequence[InterfaceValue]


@dataclass
class Vector3(IdlStruct, typename="geometry_msgs::msg::dds_::Vector3_"):
    x_: float64
    y_: float64
    z_: float64


@dataclass
class Twist(IdlStruct, typename="geometry_msgs::msg::dds_::Twist_"):
    linear_: Vector3
    angular_: Vector3


@dataclass
class TwistStamped(IdlStruct, typename="geometry_msgs::msg::dds_::TwistStamped_"):
    header_: Header
    twist_: Twist


class Watchdog(Listener):
    """What the middleware calls, in a thread of its own, when nothing has come for the deadline."""

    def __init__(self):
        super().__init__()
        self.missed = threading.Event()

    def on_requested_deadline_missed(self, _reader, _status):
        """Leave the feed-forward out, ramping down; here it is only remembered."""
        self.missed.set()


RELIABLE = Policy.Reliability.Reliable(duration(seconds=0.1))
CDR = Policy.DataRepresentation(use_cdrv0_representation=True)
participant, watchdog = DomainParticipant(DOMAIN), Watchdog()
speeds = DataWriter(participant, Topic(participant, "rt/speed", TwistStamped), qos=Qos(RELIABLE, CDR))
estimates = DataReader(
    participant,
    Topic(participant, "rt/trackres/estimate", Estimate),
    qos=Qos(RELIABLE, CDR, Policy.History.KeepLast(1), Policy.Deadline(duration(seconds=DEADLINE_S))),
    listener=watchdog,
)


def drive():
    """Publish a speed, and give what the last estimate says, if one has come: names and values of each group."""
    zero, now = Vector3(0.0, 0.0, 0.0), time.time_ns()
    stamp = Time(now // 10**9, now % 10**9)
    speeds.write(TwistStamped(Header(stamp, "base_link"), Twist(Vector3(8.0, 0.0, 0.0), zero)))
    time.sleep(0.02)
    for message in estimates.take():
        groups = zip(message.interface_groups_, message.interface_values_, strict=True)
        return {name: dict(zip(group.interface_names_, group.values_, strict=True)) for name, group in groups}
    return None


def wait(holds):
    """Drive until something holds of an estimate."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        found = drive()
        if found and holds(found):
            return found
    raise SystemExit("the node has not answered")


command = [sys.executable, "-P", "-m", "trackres_ros", "live", "--edge", "dds", "--quiet", "--vehicle", "xgd24d"]
node = subprocess.Popen([*command, "-p", "state_file:=none"], stderr=subprocess.DEVNULL)
try:
    found = wait(lambda groups: groups["vehicle"]["feedforward_torque_nm"] > 1000.0)
    torque, std = found["vehicle"]["feedforward_torque_nm"], found["vehicle"]["resistance_std_nm"]
    print(f"feed-forward {torque:.0f} Nm, standard deviation {std:.0f} Nm, level {found['vehicle']['level']:.0f}")
    print(f"because of: {', '.join(found['reasons'])}")

    watchdog.missed.clear()
    node.send_signal(signal.SIGSTOP)
    print(f"the node hangs: the deadline was missed: {watchdog.missed.wait(PATIENCE_S)}")

    node.send_signal(signal.SIGCONT)
    found = wait(lambda groups: groups["vehicle"]["level"] < 2 and groups["vehicle"]["feedforward_torque_nm"] > 1000.0)
    print("the node goes on: the feed-forward is back")
finally:
    node.send_signal(signal.SIGCONT)
    node.terminate()
    node.wait()
