/* @TITLE@: resistance torque, belt temperature and feed-forward.
 *
@MADE@
 *
 * Each function is translated from the one of the same name that runs live, in the file that stands behind its meaning.
 */
#include "trackres.h"

#include <math.h>
#include <stddef.h>

#ifdef __FAST_MATH__
#error "NAN means that something is not known: compile without -ffast-math"
#endif

/* Whole arrays without gaps, so that a checksum sees nothing that is not set. */
typedef char tr_state_has_no_gaps[sizeof(trackres_state) == @STATE_BYTES@ ? 1 : -1];

@HELPERS@
@STRUCTS@
@TABLES@
@PROTOTYPES@
@FUNCTIONS@
static uint32_t tr_checksum(const trackres_state *state)
{
    const unsigned char *bytes = (const unsigned char *)state;
    uint32_t sum = UINT32_C(2166136261); /* FNV-1a */
    for (size_t i = 2 * sizeof(uint32_t); i < sizeof(trackres_state); i++) {
        sum = (sum ^ bytes[i]) * UINT32_C(16777619);
    }
    return sum;
}

void trackres_init(trackres_state *state)
{
    state->version = TRACKRES_VERSION;
@INIT@
    state->checksum = tr_checksum(state);
}

void trackres_seal(trackres_state *state)
{
    state->checksum = tr_checksum(state);
}

bool trackres_is_sound(const trackres_state *state)
{
    return state->version == TRACKRES_VERSION && state->checksum == tr_checksum(state);
}

void trackres_no_inputs(trackres_inputs *inputs)
{
@NO_INPUTS@
}

/* Results of the last step by name, with what goes on by itself since then: feed-forward, reasons and level. */
static int tr_answer(const trackres_state *state, int64_t result, trackres_outputs *outputs)
{
@RECORDS_OF_ANSWER@
    const int64_t latest = state->clock[1];
    if (result == TRACKRES_BAD_TIME) {
        return TRACKRES_BAD_TIME;
    }
@ROW@
    if (result != TRACKRES_STEPPED) {
        outputs->feedforward_torque_nm = @FEEDFORWARD@;
        outputs->reasons |= (uint32_t)@REASONS_NOW@;
    }
    if (@IS_STALE@) {
        outputs->level = TRACKRES_STALE;
    } else {
        outputs->level = (outputs->reasons & ~UINT32_C(@HARMLESS@)) != 0 ? TRACKRES_WARN : TRACKRES_OK;
    }
    return (int)result;
}

int trackres_step(trackres_state *state, const trackres_inputs *inputs, trackres_real dt, trackres_outputs *outputs)
{
    const trackres_real given[@CHANNEL_COUNT@] = {
@GIVEN@
    };
    if (state->version != TRACKRES_VERSION) {
        return TRACKRES_BAD_STATE;
    }
@RECORDS_OF_STEP@
    return tr_answer(state, @STEP@, outputs);
}

int trackres_message(
    trackres_state *state, int channel, int64_t stamp_ns, int64_t arrival_ns, trackres_real value, trackres_outputs *outputs)
{
    if (state->version != TRACKRES_VERSION) {
        return TRACKRES_BAD_STATE;
    }
@RECORDS_OF_MESSAGE@
    return tr_answer(state, @MESSAGE@, outputs);
}

void trackres_rest(trackres_state *state, trackres_real ambient_degc, trackres_real seconds)
{
    if (state->version != TRACKRES_VERSION) {
        return;
    }
@RECORDS_OF_REST@
    @REST@;
}
