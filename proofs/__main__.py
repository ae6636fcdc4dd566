# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Runs `python -m proofs` in a checkout."""

from proofs.commands import proofs
from trackres_ros.tasks.main import main

if __name__ == "__main__":
    main(commands=proofs, program="python -m proofs")
