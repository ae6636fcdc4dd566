/* @TITLE@: resistance torque, belt temperature and feed-forward.
 *
@MADE@
 *
 * Written by `trackres export c`; what is changed here, `trackres export --check` reports. No heap, no files, no globals that
 * change; of libraries only math.h. One state serves one vehicle and one thread at a time.
 */
#ifndef TRACKRES_H
#define TRACKRES_H

#include <stdbool.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

typedef @REAL@ trackres_real;

/* The vehicle file, without its suffix. */
#define TRACKRES_VEHICLE @VEHICLE@

/* Of a state: another vehicle, other settings or another version of the program have another number. */
#define TRACKRES_VERSION UINT32_C(@VERSION@)

/* The longest time step [s]: a week, after which any belt is as warm as the air. More is the difference of an unsigned clock that
 * went back. */
#define TRACKRES_LONGEST_STEP_S @LONGEST_STEP@

/* What a step returns. After a negative value state and outputs are as before, bit for bit: no time has passed for them. */
enum {
    TRACKRES_STEPPED = 1,    /* a speed was accepted: all outputs are new */
    TRACKRES_WAITED = 0,     /* no speed, or one that the guards refused: only feed-forward, reasons and level are new */
    TRACKRES_BAD_STATE = -1, /* the state is not of this version: call trackres_init */
    TRACKRES_BAD_TIME = -2   /* dt is negative, NAN, infinite or above TRACKRES_LONGEST_STEP_S: pass the next one from a clock that
                              * never goes back. Or a stamp, an arrival or the sum of all dt is more than 146 years from 0. */
};

/* How far the outputs can be used, as in diagnostic_msgs: a stale speed is too old. */
enum { TRACKRES_OK = 0, TRACKRES_WARN = 1, TRACKRES_STALE = 3 };

/* Why the level is not OK; several may hold. */
enum {
@REASONS@
};

/* Kinds of message, for trackres_message. */
enum {
@CHANNELS@
};

/* What is known now, in SI and degC; NAN where nothing new came. */
typedef struct {
@INPUTS@
} trackres_inputs;

/* Written as a whole by each call that is no error. */
typedef struct {
@OUTPUTS@
    uint32_t reasons; /* bits of TRACKRES_... */
    int32_t level;    /* TRACKRES_OK, TRACKRES_WARN or TRACKRES_STALE */
} trackres_outputs;

/* All that is carried from step to step. It may be copied and stored as it is: seal it before, check it afterwards. */
typedef struct {
    uint32_t version;
    uint32_t checksum; /* of all behind it, as trackres_seal left it */
@STATE@
} trackres_state;

/* A new state: belts at the ambient temperature, nothing received yet. */
void trackres_init(trackres_state *state);

/* Inputs of which none is known. */
void trackres_no_inputs(trackres_inputs *inputs);

/* Take in what is known now, dt [s] after the last call that was no error: from 0 to TRACKRES_LONGEST_STEP_S, and parts of a
 * nanosecond add up. To be called in each control step, with or without a new speed. Enable, fade and rate hold in the time that
 * these dt add up to. The feed-forward moves by up to its largest rate times dt, and by that of 20 ms more in a call with an
 * accepted speed. A second speed without time in between is refused. */
int trackres_step(trackres_state *state, const trackres_inputs *inputs, trackres_real dt, trackres_outputs *outputs);

/* Take in one message with its own stamp and its arrival [ns], by a clock that never goes back: all guards of the live node, late
 * and double messages too. An arrival up to 20 ms before the last counts as with it. From one that is earlier, the speed is old
 * and the feed-forward 0 until the next speed. */
int trackres_message(
    trackres_state *state, int channel, int64_t stamp_ns, int64_t arrival_ns, trackres_real value, trackres_outputs *outputs);

/* Begin again after a rest, or after power was off: belts have cooled for so long [s] at an ambient temperature [degC]. NAN is the
 * last known one; more than a week counts as a week. */
void trackres_rest(trackres_state *state, trackres_real ambient_degc, trackres_real seconds);

/* Write the checksum before the state is stored; tell whether a stored one is whole and of this vehicle and version. */
void trackres_seal(trackres_state *state);
bool trackres_is_sound(const trackres_state *state);

#ifdef __cplusplus
}
#endif

#endif
