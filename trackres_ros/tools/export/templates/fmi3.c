/* The exported step behind FMI 3.0 for co-simulation. Each instance has memory of its own; the step asks for none. */
#include "trackres.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif

#define TOKEN "@TOKEN@"

/* Types of the standard that are used here. */
typedef void *fmi3Instance, *fmi3FMUState, *fmi3InstanceEnvironment;
typedef uint32_t fmi3ValueReference;
typedef enum { fmi3OK, fmi3Warning, fmi3Discard, fmi3Error, fmi3Fatal } fmi3Status;
typedef void (*fmi3LogMessageCallback)(fmi3InstanceEnvironment, fmi3Status, const char *, const char *);
typedef void (*fmi3AnyCallback)(void);

struct instance {
    trackres_state state;
    trackres_inputs inputs;
    trackres_outputs outputs;
    double time;  /* [s] */
    double speed; /* input of the last step [m/s] */
    bool begun;   /* whether there was a first step */
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
};

enum causality { INDEPENDENT, INPUT, OUTPUT, PARAMETER };

/* A variable: where it stands in an instance. Of an effect's parameter so many rows of the table of effects move with it; what
 * effects look at stands in another place too. */
struct variable {
    size_t place;
    int rows;
    size_t stride;
    size_t also; /* 0 without one */
    enum causality causality;
    double low; /* of a parameter, and its highest value */
    double high;
};

static const double longest_s = @LONGEST_S@; /* of a piece: a speed that is older is a dropout */
static const double most_pieces = 20000.0;     /* as the belts have */

enum { OF_REASONS = @OF_REASONS@, OF_LEVEL = @OF_LEVEL@, TIME = 0, VARIABLES = @VARIABLE_COUNT@ };

static const struct variable variables[VARIABLES] = {
@VARIABLES@
};

static double *number_at(struct instance *one, size_t place)
{
    return (double *)(void *)((char *)one + place);
}

static fmi3Status failed(struct instance *one, const char *text)
{
    if (one->log != NULL) {
        one->log(one->environment, fmi3Error, "logStatusError", text);
    }
    return fmi3Error;
}

static void begin(struct instance *one)
{
    trackres_init(&one->state);
    trackres_no_inputs(&one->inputs);
    one->inputs.speed_mps = 0.0;
    memset(&one->outputs, 0, sizeof one->outputs);
    one->time = 0.0;
    one->begun = false;
}

EXPORTED const char *fmi3GetVersion(void)
{
    return "3.0";
}

EXPORTED fmi3Status fmi3SetDebugLogging(fmi3Instance instance, bool on, size_t count, const char *const categories[])
{
    (void)instance, (void)on, (void)count, (void)categories;
    return fmi3OK;
}

EXPORTED fmi3Instance fmi3InstantiateCoSimulation(
    const char *name, const char *token, const char *resources, bool visible, bool logging, bool event_mode, bool early_return,
    const fmi3ValueReference intermediate[], size_t intermediate_count, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3AnyCallback update)
{
    (void)name, (void)resources, (void)visible, (void)event_mode, (void)early_return;
    (void)intermediate, (void)intermediate_count, (void)update;
    if (token == NULL || strcmp(token, TOKEN) != 0) {
        if (log != NULL) {
            log(environment, fmi3Error, "logStatusError", "the instantiation token is that of another FMU");
        }
        return NULL;
    }
    struct instance *one = calloc(1, sizeof *one);
    if (one != NULL) {
        one->environment = environment;
        one->log = logging ? log : NULL;
        begin(one);
    }
    return one;
}

EXPORTED fmi3Instance fmi3InstantiateModelExchange(
    const char *name, const char *token, const char *resources, bool visible, bool logging, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    return NULL;
}

EXPORTED fmi3Instance fmi3InstantiateScheduledExecution(
    const char *name, const char *token, const char *resources, bool visible, bool logging, fmi3InstanceEnvironment environment,
    fmi3LogMessageCallback log, fmi3AnyCallback clock, fmi3AnyCallback lock, fmi3AnyCallback unlock)
{
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)environment, (void)log;
    (void)clock, (void)lock, (void)unlock;
    return NULL;
}

EXPORTED void fmi3FreeInstance(fmi3Instance instance)
{
    free(instance);
}

EXPORTED fmi3Status fmi3EnterInitializationMode(
    fmi3Instance instance, bool has_tolerance, double tolerance, double start, bool has_stop, double stop)
{
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    ((struct instance *)instance)->time = start;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    struct instance *one = instance;
    one->speed = one->inputs.speed_mps;
    one->begun = true;
    return trackres_step(&one->state, &one->inputs, 0.0, &one->outputs) < 0 ? failed(one, "no first step") : fmi3OK;
}

EXPORTED fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    return failed(instance, "there is no event mode");
}

EXPORTED fmi3Status fmi3Terminate(fmi3Instance instance)
{
    (void)instance;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3Reset(fmi3Instance instance)
{
    begin(instance);
    return fmi3OK;
}

/* One step in pieces, so that no speed in it is too old for the feed-forward. Along them the speed changes evenly, in steps that
 * are no resolution of a sensor: the smallest step known of the speed stays as it is. */
static int step_in_pieces(struct instance *one, double step)
{
    const int pieces = (int)fmin(ceil(step / longest_s), most_pieces);
    const double change = one->inputs.speed_mps - one->speed; /* NAN where one of them is not known */
    const double even = isfinite(change) ? change : 0.0;
    trackres_inputs inputs = one->inputs;
    double *const smallest = &one->state.motion[@SMALLEST_STEP@];
    int result = TRACKRES_WAITED;
    for (int left = pieces - 1; left >= 0 && result >= 0; left--) {
        const double known = *smallest;
        inputs.speed_mps = one->inputs.speed_mps - even * left / pieces;
        *smallest = pieces > 1 && known >= @LARGEST_QUANTUM@ ? 0.0 : known;
        result = trackres_step(&one->state, &inputs, step / pieces, &one->outputs);
        *smallest = pieces > 1 ? fmax(*smallest, known) : *smallest;
    }
    one->speed = one->inputs.speed_mps;
    return result;
}

EXPORTED fmi3Status fmi3DoStep(
    fmi3Instance instance, double time, double step, bool no_way_back, bool *event_needed, bool *terminate, bool *early_return,
    double *last_time)
{
    struct instance *one = instance;
    (void)no_way_back;
    *event_needed = *terminate = *early_return = false;
    *last_time = time;
    if (!(step > 0.0 && step <= TRACKRES_LONGEST_STEP_S) || step_in_pieces(one, step) < 0) {
        return failed(one, "a communication step is more than 0 s, and a week at most");
    }
    one->time = *last_time = time + step;
    return fmi3OK;
}

/* Before the first step the outputs are those that it would give. */
static struct instance *with_outputs(fmi3Instance instance)
{
    struct instance *one = instance;
    if (!one->begun) {
        trackres_state state = one->state;
        (void)trackres_step(&state, &one->inputs, 0.0, &one->outputs);
    }
    return one;
}

EXPORTED fmi3Status fmi3GetFloat64(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, double values[], size_t value_count)
{
    struct instance *one = with_outputs(instance);
    for (size_t i = 0; i < count; i++) {
        if (references[i] >= VARIABLES || i >= value_count) {
            return failed(one, "no variable of this reference");
        }
        values[i] = *number_at(one, variables[references[i]].place);
    }
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SetFloat64(
    fmi3Instance instance, const fmi3ValueReference references[], size_t count, const double values[], size_t value_count)
{
    struct instance *one = instance;
    for (size_t i = 0; i < count; i++) {
        const struct variable *variable = references[i] < VARIABLES && i < value_count ? &variables[references[i]] : NULL;
        if (variable == NULL || (variable->causality != INPUT && variable->causality != PARAMETER)) {
            return failed(one, "no input or parameter of this reference");
        }
        if (variable->causality == PARAMETER && !(variable->low <= values[i] && values[i] <= variable->high)) {
            return failed(one, "a parameter that is no number from its min to its max");
        }
        const double moved = values[i] - *number_at(one, variable->place);
        for (int row = 1; row < variable->rows; row++) {
            *number_at(one, variable->place + (size_t)row * variable->stride) += moved;
        }
        *number_at(one, variable->place) = values[i];
        if (variable->also != 0) {
            *number_at(one, variable->also) = values[i];
        }
    }
    return fmi3OK;
}

/* A variable that is the only one of its type. */
#define ONLY_VARIABLE(type, kind, reference, output)                                                                             \
    EXPORTED fmi3Status fmi3Get##type(                                                                                           \
        fmi3Instance instance, const fmi3ValueReference references[], size_t count, kind values[], size_t value_count)           \
    {                                                                                                                            \
        struct instance *one = with_outputs(instance);                                                                           \
        for (size_t i = 0; i < count; i++) {                                                                                     \
            if (references[i] != (reference) || i >= value_count) {                                                              \
                return failed(one, "no whole number of this reference");                                                         \
            }                                                                                                                    \
            values[i] = one->outputs.output;                                                                                     \
        }                                                                                                                        \
        return fmi3OK;                                                                                                           \
    }

ONLY_VARIABLE(UInt32, uint32_t, OF_REASONS, reasons)
ONLY_VARIABLE(Int32, int32_t, OF_LEVEL, level)

/* A state of an instance is a copy of it; kept of it is what stands before its environment. */
enum { KEPT = offsetof(struct instance, environment) };

EXPORTED fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    if (*state == NULL) {
        *state = malloc(sizeof(struct instance));
    }
    if (*state == NULL) {
        return failed(instance, "no memory for a state");
    }
    memcpy(*state, instance, sizeof(struct instance));
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState state)
{
    memcpy(instance, state, KEPT);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *state)
{
    (void)instance;
    free(*state);
    *state = NULL;
    return fmi3OK;
}

/* Stored are the bytes that are kept, and their checksum (FNV-1a). */
enum { STORED = KEPT + sizeof(uint32_t) };

static uint32_t checksum(const uint8_t *bytes)
{
    uint32_t sum = UINT32_C(2166136261);
    for (size_t i = 0; i < KEPT; i++) {
        sum = (sum ^ bytes[i]) * UINT32_C(16777619);
    }
    return sum;
}

EXPORTED fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState state, size_t *size)
{
    (void)instance, (void)state;
    *size = STORED;
    return fmi3OK;
}

EXPORTED fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState state, uint8_t bytes[], size_t size)
{
    struct instance *from = state;
    if (size < STORED) {
        return failed(instance, "too little room for a state");
    }
    trackres_seal(&from->state);
    memcpy(bytes, from, KEPT);
    const uint32_t sum = checksum(bytes);
    memcpy(bytes + KEPT, &sum, sizeof sum);
    return fmi3OK;
}

EXPORTED fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const uint8_t bytes[], size_t size, fmi3FMUState *state)
{
    uint32_t sum = 0;
    if (size < STORED) {
        return failed(instance, "too few bytes for a state");
    }
    memcpy(&sum, bytes + KEPT, sizeof sum);
    if (sum != checksum(bytes)) {
        return failed(instance, "a damaged state");
    }
    if (fmi3GetFMUState(instance, state) != fmi3OK) {
        return fmi3Error;
    }
    memcpy(*state, bytes, KEPT);
    return trackres_is_sound(&((struct instance *)*state)->state) ? fmi3OK : failed(instance, "a state of another FMU");
}

/* Types of variable that this FMU does not have. */
#define NO_VARIABLES_OF(type, kind)                                                                                              \
    EXPORTED fmi3Status fmi3Get##type(                                                                                           \
        fmi3Instance instance, const fmi3ValueReference references[], size_t count, kind values[], size_t value_count)          \
    {                                                                                                                            \
        (void)references, (void)values, (void)value_count;                                                                       \
        return count == 0 ? fmi3OK : failed(instance, "no variable of this type");                                               \
    }                                                                                                                            \
    NOTHING_TO_SET(type, kind)

#define NOTHING_TO_SET(type, kind)                                                                                               \
    EXPORTED fmi3Status fmi3Set##type(                                                                                           \
        fmi3Instance instance, const fmi3ValueReference references[], size_t count, const kind values[], size_t value_count)    \
    {                                                                                                                            \
        (void)references, (void)values, (void)value_count;                                                                       \
        return count == 0 ? fmi3OK : failed(instance, "no input or parameter of this type");                                     \
    }

typedef const char *text;
NO_VARIABLES_OF(Float32, float)
NO_VARIABLES_OF(Int8, int8_t)
NO_VARIABLES_OF(UInt8, uint8_t)
NO_VARIABLES_OF(Int16, int16_t)
NO_VARIABLES_OF(UInt16, uint16_t)
NOTHING_TO_SET(Int32, int32_t)
NOTHING_TO_SET(UInt32, uint32_t)
NO_VARIABLES_OF(Int64, int64_t)
NO_VARIABLES_OF(UInt64, uint64_t)
NO_VARIABLES_OF(Boolean, bool)
NO_VARIABLES_OF(String, text)

/* Functions of the standard for what this FMU does not offer; importers look for all of them. */
#define NOT_OFFERED(name, ...)                                                                                                   \
    EXPORTED fmi3Status fmi3##name(fmi3Instance instance, __VA_ARGS__)                                                          \
    {                                                                                                                            \
        return failed(instance, "fmi3" #name " is not offered");                                                                 \
    }

typedef const fmi3ValueReference *references;
typedef size_t number;
NOT_OFFERED(GetBinary, references r, number n, size_t sizes[], const uint8_t *values[], number m)
NOT_OFFERED(SetBinary, references r, number n, const size_t sizes[], const uint8_t *const values[], number m)
NOT_OFFERED(GetClock, references r, number n, bool values[])
NOT_OFFERED(SetClock, references r, number n, const bool values[])
NOT_OFFERED(GetNumberOfVariableDependencies, fmi3ValueReference r, size_t *n)
NOT_OFFERED(GetVariableDependencies, fmi3ValueReference r, size_t a[], fmi3ValueReference b[], size_t c[], int kinds[], number n)
NOT_OFFERED(GetDirectionalDerivative, references u, number n, references k, number m, const double s[], number o, double d[], number p)
NOT_OFFERED(GetAdjointDerivative, references u, number n, references k, number m, const double s[], number o, double d[], number p)
NOT_OFFERED(GetIntervalDecimal, references r, number n, double intervals[], int qualifiers[])
NOT_OFFERED(GetIntervalFraction, references r, number n, uint64_t counters[], uint64_t resolutions[], int qualifiers[])
NOT_OFFERED(GetShiftDecimal, references r, number n, double shifts[])
NOT_OFFERED(GetShiftFraction, references r, number n, uint64_t counters[], uint64_t resolutions[])
NOT_OFFERED(SetIntervalDecimal, references r, number n, const double intervals[])
NOT_OFFERED(SetIntervalFraction, references r, number n, const uint64_t counters[], const uint64_t resolutions[])
NOT_OFFERED(SetShiftDecimal, references r, number n, const double shifts[])
NOT_OFFERED(SetShiftFraction, references r, number n, const uint64_t counters[], const uint64_t resolutions[])
NOT_OFFERED(UpdateDiscreteStates, bool *a, bool *b, bool *c, bool *d, bool *e, double *time)
NOT_OFFERED(CompletedIntegratorStep, bool no_way_back, bool *event_mode, bool *terminate)
NOT_OFFERED(SetTime, double time)
NOT_OFFERED(SetContinuousStates, const double states[], number n)
NOT_OFFERED(GetContinuousStateDerivatives, double derivatives[], number n)
NOT_OFFERED(GetEventIndicators, double indicators[], number n)
NOT_OFFERED(GetContinuousStates, double states[], number n)
NOT_OFFERED(GetNominalsOfContinuousStates, double nominals[], number n)
NOT_OFFERED(GetNumberOfEventIndicators, size_t *n)
NOT_OFFERED(GetNumberOfContinuousStates, size_t *n)
NOT_OFFERED(GetOutputDerivatives, references r, number n, const int32_t orders[], double values[], number m)
NOT_OFFERED(ActivateModelPartition, fmi3ValueReference clock, double time)

#define NOT_ENTERED(name)                                                                                                        \
    EXPORTED fmi3Status fmi3##name(fmi3Instance instance)                                                                       \
    {                                                                                                                            \
        return failed(instance, "fmi3" #name " is not offered");                                                                 \
    }

NOT_ENTERED(EnterConfigurationMode)
NOT_ENTERED(ExitConfigurationMode)
NOT_ENTERED(EvaluateDiscreteStates)
NOT_ENTERED(EnterContinuousTimeMode)
