"""`python -m trackres_ros`: the `trackres` command."""

from trackres_ros.cli.entry import main

main()
