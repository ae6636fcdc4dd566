/* Drives the exported step at a rate [Hz] for hours: up to SPEED, steady, and at rest in the last quarter. Prints the outputs every
 * ten seconds. */
#include "trackres.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { NUMBERS = offsetof(trackres_outputs, reasons) / sizeof(trackres_real) };

int main(int count, char **words)
{
    static trackres_state state;
    trackres_inputs inputs;
    trackres_outputs outputs;
    trackres_real shown[NUMBERS];
    const double rate = count > 2 ? atof(words[1]) : 50.0;
    const double seconds = count > 2 ? 3600.0 * atof(words[2]) : 60.0;
    const long steps = (long)(rate * seconds);
    double speed = 0.0;
    memset(&outputs, 0, sizeof outputs);
    trackres_init(&state);
    for (long n = 0; n < steps; n++) {
        speed += (4 * n < 3 * steps ? 1.0 : -1.0) / rate;
        speed = speed > SPEED ? SPEED : speed < 0.0 ? 0.0 : speed;
        trackres_no_inputs(&inputs);
        inputs.speed_mps = (trackres_real)speed;
        inputs.ambient_degc = (trackres_real)15.0;
        if (trackres_step(&state, &inputs, (trackres_real)(1.0 / rate), &outputs) != TRACKRES_STEPPED) {
            (void)fprintf(stderr, "a speed was not accepted\n");
            return 1;
        }
        if (n % (long)(10.0 * rate) == 0) {
            memcpy(shown, &outputs, sizeof shown);
            for (size_t i = 0; i < NUMBERS; i++) {
                (void)printf("%.9g%c", (double)shown[i], i + 1 < NUMBERS ? ',' : '\n');
            }
        }
    }
    return 0;
}
