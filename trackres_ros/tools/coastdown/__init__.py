# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""Recordings of coast-downs come in; resistance parameters with their uncertainty go out."""
