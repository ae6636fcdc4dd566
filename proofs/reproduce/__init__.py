# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Repeats the paper's figures and tests, and reports which of its claims hold, which do not, and why."""

from proofs.reproduce.run import reproduce

__all__ = ["reproduce"]
