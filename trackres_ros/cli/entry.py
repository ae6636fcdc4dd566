"""What the command `trackres` calls: it listens to signals, or is ready for Ctrl-C, before all else is loaded."""

from __future__ import annotations

import sys

INTERRUPTED = 130


def main() -> None:
    """Run the command line."""
    if next((word for word in sys.argv[1:] if not word.startswith("-")), "") == "live":
        from trackres_ros.live.asked import ASKED

        ASKED.listen()
    try:
        from trackres_ros.cli.main import main as run
    except KeyboardInterrupt:
        print("trackres: interrupted; nothing was begun", file=sys.stderr)
        sys.exit(INTERRUPTED)
    run()


if __name__ == "__main__":
    main()
