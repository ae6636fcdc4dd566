/* Times the exported step: so many steps with a new speed each, with four or so loads that differ, in several rounds. */
#define _POSIX_C_SOURCE 199309L
#include "trackres.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

int main(int count, char **words)
{
    static trackres_state state;
    trackres_inputs inputs;
    trackres_outputs outputs;
    const long steps = count > 1 ? atol(words[1]) : 100000;
    const int rounds = count > 2 ? atoi(words[2]) : 5;
    memset(&outputs, 0, sizeof outputs);
    trackres_init(&state);
    for (int round = 0; round < rounds; round++) {
        double most = 0.0;
        const double begin = now_s();
        for (long n = 0; n < steps; n++) {
            trackres_no_inputs(&inputs);
            inputs.speed_mps = (trackres_real)(SPEED + 0.01 * (double)(n % 7));
            LOADS
            if (trackres_step(&state, &inputs, (trackres_real)0.01, &outputs) != TRACKRES_STEPPED) {
                (void)fprintf(stderr, "a speed was not accepted\n");
                return 1;
            }
        }
        const double each = (now_s() - begin) / (double)steps;
        for (long n = 0; n < 1000; n++) { /* single steps, for the slowest of them */
            const double before = now_s();
            inputs.speed_mps = (trackres_real)(SPEED + 0.01 * (double)(n % 7));
            (void)trackres_step(&state, &inputs, (trackres_real)0.01, &outputs);
            const double took = now_s() - before;
            most = took > most ? took : most;
        }
        (void)printf("%.9g %.9g %.17g\n", each, most, (double)outputs.resistance_torque_nm);
    }
    return 0;
}
