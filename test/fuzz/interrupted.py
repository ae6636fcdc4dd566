# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Makes a call of the command line in a process of its own and interrupts it: long enough to see whether it is refused."""

import contextlib
import json
import os
import resource
import select
import signal
import traceback
import warnings

HANGS_S = 60.0
MOST_BYTES = 16 << 30  # of the address space, of which libraries take some


def interrupted(trackres, call, folder, longest_s, environment=None):
    """Exit code and standard error of a call, made in a fork and interrupted after a while, as by Ctrl-C."""
    fired = []

    def interrupt(*_):
        fired.append(True)
        raise KeyboardInterrupt

    read, write = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # a fork of a process that has threads, of pytest's own
        child = os.fork()
    if child == 0:
        found = [130, ""]
        os.setsid()  # what it starts is ended with it
        try:
            resource.setrlimit(resource.RLIMIT_AS, (MOST_BYTES, MOST_BYTES))
            os.environ.update(environment or {})
            signal.signal(signal.SIGALRM, interrupt)
            signal.setitimer(signal.ITIMER_REAL, longest_s, longest_s)
            done = trackres(*call, cwd=folder)
            found = [done.returncode, done.stderr]
        except KeyboardInterrupt:  # in the moment in which the command ends or begins
            pass
        except BaseException:
            if not fired:  # else C code may have made another error of the interrupt, as ast.parse and pybind11 do
                found = [1, traceback.format_exc()]
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            code, said = found
            os.write(write, json.dumps([code, said[-20_000:]]).encode() + b"\n")
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as said:
        answered = select.select([said], [], [], HANGS_S)[0]
        found = json.loads(said.readline() or "null") if answered else None
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    return found or (1, "it hangs, or died")
