# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""`python -m trackres_ros`: the `trackres` command."""

from trackres_ros.tasks.entry import main

main()
