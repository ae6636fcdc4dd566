# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""What is believed in, vehicle file, surroundings and lines of the topics file out."""
