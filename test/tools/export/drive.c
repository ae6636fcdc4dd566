/* Takes many messages through the exported step, for the tests: a row of outputs for each step. */
#include "trackres.h"

#include <stddef.h>
#include <string.h>

/* Sizes that a caller without the header needs. */
int64_t drive_size_of_state(void) { return (int64_t)sizeof(trackres_state); }
int64_t drive_size_of_outputs(void) { return (int64_t)sizeof(trackres_outputs); }
int64_t drive_place_of_counters(void) { return (int64_t)offsetof(trackres_state, counters); }
int64_t drive_place_of_motion(void) { return (int64_t)offsetof(trackres_state, motion); }

int64_t drive_messages(trackres_state *state, int64_t count, const int16_t *channels, const int64_t *stamps,
                       const int64_t *arrivals, const double *values, trackres_outputs *rows)
{
    trackres_outputs now;
    int64_t steps = 0;
    memset(&now, 0, sizeof now);
    for (int64_t i = 0; i < count; i++) {
        const int result = trackres_message(state, channels[i], stamps[i], arrivals[i], (trackres_real)values[i], &now);
        if (result == TRACKRES_STEPPED) {
            rows[steps] = now;
            steps++;
        } else if (result < 0) {
            return result;
        }
    }
    return steps;
}
