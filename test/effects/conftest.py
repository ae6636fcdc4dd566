# Copyright the trackres_ros authors
# SPDX-License-Identifier: Apache-2.0

"""A step of effects alone, on the reference vehicle."""

import pytest

from trackres_ros.building import built
from trackres_ros.effects.stepping import (
    ALL_WELL,
    EXTRAPOLATED,
    EffectTable,
    effect_table,
    new_effect_scratch,
    new_memory,
    set_conditions,
    step_effects,
)
from trackres_ros.model.track import vehicle_constants


@pytest.fixture(scope="session")
def stepped(xgd24d):
    """The terms of effects, or of their table, by the step in C or in plain Python; it changes their memory."""
    facts = vehicle_constants(xgd24d)
    module = built({"step_effects": step_effects}, "-O0")
    in_c = step_effects if module is None else module.step_effects

    def step(effects, at, memory=None, machine=True, dt=0.0):
        table = effects if isinstance(effects, EffectTable) else effect_table(effects)
        scratch, memory = new_effect_scratch(facts), new_memory(len(table.rows)) if memory is None else memory
        set_conditions(scratch.conditions, *at[1:9], at.belt)
        run = in_c if machine else step_effects
        assert run(table.rows, table.values, memory, scratch, dt) in (ALL_WELL, EXTRAPOLATED)
        return scratch.terms

    return step
