"""`python -m trackres_ros`: the `trackres` command."""

from trackres_ros.cli.main import main

main()
