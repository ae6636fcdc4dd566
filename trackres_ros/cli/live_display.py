# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Shows the running node from a thread of its own, in some way."""

import threading
from abc import ABC, abstractmethod
from collections.abc import Callable

from trackres_ros.node.status import Overview

END_PATIENCE_S = 2.0


class LiveDisplay(ABC):
    """Shows an overview again and again, until it is stopped."""

    def __init__(self, overview: Callable[[], Overview]) -> None:
        self._overview = overview
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="display", daemon=True)

    def start(self) -> None:
        """Begin to show."""
        self._thread.start()

    def stop(self) -> bool:
        """Show the last state and stop; return whether the thread ended: a reader may not take what is shown."""
        self._stop.set()
        self._thread.join(END_PATIENCE_S)
        return not self._thread.is_alive()

    @abstractmethod
    def _run(self) -> None:
        """Show the overview until `_stop` is set, and once more then."""
