/* Times the exported step and the bare one, in turns: `program STEPS EVICTED`. Prints seconds a step, exported and bare, for each of
 * five rounds in a tight loop; then for each of EVICTED single steps with a walk over 64 MB before it. The last line has both
 * torques. */
#define _POSIX_C_SOURCE 199309L
#include "bare_step.c"
#include "trackres.h"

#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { BALLAST = 64 << 20, LINE = 64, ROUNDS = 5 };

static trackres_state state;
static trackres_inputs inputs;
static trackres_outputs outputs;
static struct bare bare;
static unsigned char *ballast;
static double torque;

static double now_s(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static double speed_of(long n)
{
    return 10.0 + 0.01 * (double)(n % 7);
}

static void exported(long n)
{
    inputs.speed_mps = speed_of(n);
    if (trackres_step(&state, &inputs, 0.01, &outputs) != TRACKRES_STEPPED) {
        (void)fprintf(stderr, "a speed was not accepted\n");
        exit(1);
    }
}

static void plain(long n)
{
    torque = bare_step(&bare, speed_of(n), 0.01);
}

static double loop(void (*one)(long), long steps)
{
    const double begin = now_s();
    for (long n = 0; n < steps; n++) {
        one(n);
    }
    return (now_s() - begin) / (double)steps;
}

static double evicted(void (*one)(long), long n)
{
    for (size_t i = 0; i < BALLAST; i += LINE) {
        ballast[i]++;
    }
    const double begin = now_s();
    one(n);
    return now_s() - begin;
}

int main(int count, char **words)
{
    const long steps = count > 2 ? atol(words[1]) : 100000, singles = count > 2 ? atol(words[2]) : 100;
    ballast = calloc(BALLAST, 1);
    if (ballast == NULL) {
        return 1;
    }
    memset(&outputs, 0, sizeof outputs);
    trackres_init(&state);
    bare_begin(&bare);
    trackres_no_inputs(&inputs);
    SET_LOADS
    for (int round = 0; round < ROUNDS; round++) {
        const double ours = loop(exported, steps);
        (void)printf("%.9g %.9g\n", ours, loop(plain, steps));
    }
    for (long n = 0; n < singles; n++) {
        const double ours = evicted(exported, n);
        (void)printf("%.9g %.9g\n", ours, evicted(plain, n));
    }
    (void)printf("%.9g %.9g\n", outputs.resistance_torque_nm, torque);
    free(ballast);
    return 0;
}
