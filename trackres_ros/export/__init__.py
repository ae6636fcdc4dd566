# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A vehicle and the compiled step come in; C99 and an FMU that give the same numbers go out. Begin at `exporting`."""
