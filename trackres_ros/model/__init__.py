# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""The physics of a rubber-track assembly, pure and one file a subject; equations are those of Liang et al., Polymers 2023.

SI inside, temperatures in degC, forces of loss in newtons (joules per metre of travel). docs/model.md has the whole model
with its nomenclature, docs/errata.md says where and why it departs from the paper as printed.
"""
