# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs commands of ROS 2 as a person does in a shell."""

import os
import shutil
import signal
import subprocess
import sys
from contextlib import suppress

from peer import domain_of_worker
from waiting import exit_code, wait_for

ROS2 = shutil.which("ros2")
DOMAIN = str(domain_of_worker(72))


class Shell:
    """Runs commands in one environment and ends all processes it started."""

    def __init__(self, folder, environment):
        self.folder, self.running = folder, []
        self.environment = {**environment, "ROS_DOMAIN_ID": DOMAIN, "ROS_LOG_DIR": str(folder / "log")}

    def ros2(self, *arguments, within_s=30.0, check=True):
        """Output of a `ros2` command."""
        done = subprocess.run(
            [ROS2, *arguments], env=self.environment, capture_output=True, text=True, timeout=within_s, cwd=self.folder
        )
        assert not check or done.returncode == 0, done.stderr
        return done.stdout + ("" if check else done.stderr)

    def start(self, *command):
        """A process in the background; its output goes to a file."""
        path = self.folder / f"out-{len(self.running)}.log"
        with path.open("w") as out:
            process = subprocess.Popen(
                command, env=self.environment, stdout=out, stderr=out, stdin=subprocess.DEVNULL, cwd=self.folder,
                start_new_session=True,
            )  # fmt: skip
        process.said = path.read_text
        self.running.append(process)
        return process

    def begin_estimator(self, *arguments, vehicle="xgd24d"):
        """The executable `estimator`, without a state file; ROS arguments follow."""
        given = ["-p", f"vehicle:={vehicle}", "-p", "state_file:=none", *arguments]
        return self.start(sys.executable, "-m", "trackres_ros.node.ros.estimator", "--ros-args", *given)

    def estimator(self, *arguments):
        """The same, once it is there."""
        return self._there(self.begin_estimator(*arguments))

    def without_ros(self, *arguments):
        """A node on Cyclone DDS alone, once it is there."""
        return self._there(self.start(sys.executable, "-m", "trackres_ros", "live", "--transport", "dds", "--quiet", *arguments))

    def _there(self, process):
        wait(lambda: "24 t chassis" in process.said(), process)
        return process

    def end(self, process, how=signal.SIGINT):
        """End a process; its exit code."""
        if process.poll() is None:
            process.send_signal(how)
            exit_code(process)
        with suppress(ProcessLookupError):  # what a launch that had to be killed has left
            os.killpg(process.pid, signal.SIGKILL)
        return process.returncode

    def close(self):
        """End everything."""
        for process in self.running:
            self.end(process)
        subprocess.run([ROS2, "daemon", "stop"], env=self.environment, capture_output=True, timeout=30)


def wait(holds, process=None):
    """Wait until something holds; if a process is to bring it about, as long as it computes."""
    found = wait_for(lambda: holds() or (process and process.poll() is not None), working=process and process.pid)
    assert found, process and process.said()
    assert process is None or process.poll() is None, process.said()
