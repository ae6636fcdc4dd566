/* Replays a CSV through the exported step: the same rows as `trackres replay`, for whoever checks a build. Not for a controller.
 *
 *     trackres_replay drive.csv > result.csv
 *
 * The first line names the columns: time_s, and as `trackres replay` knows them by name. An empty cell is no message, an empty
 * line no row.
 */
#include "trackres.h"

#include <errno.h>
#include <math.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LONGEST_LINE = 65536, MOST_COLUMNS = 1024, NOT_USED = -1, IS_TIME = -2 };

static const char utf8_mark[] = "\xEF\xBB\xBF"; /* which some programs write at the beginning of a file */
static const double farthest_s = 4e9;            /* in nanoseconds within 64 bits */

struct column {
    const char *name;
    size_t place;
    double scale;
};

static const struct column inputs_by_name[] = {
@INPUT_COLUMNS@
};

static const struct column outputs_by_name[] = {
@OUTPUT_COLUMNS@
};

enum { INPUTS = sizeof(inputs_by_name) / sizeof(inputs_by_name[0]), OUTPUTS = sizeof(outputs_by_name) / sizeof(outputs_by_name[0]) };

static int wrong(long line, const char *what, const char *given)
{
    (void)fprintf(stderr, "trackres_replay: line %ld: %s: %s\n", line, what, given);
    return 2;
}

/* The next cell of a line; the rest of the line goes on behind it. */
static char *next_cell(char **rest)
{
    char *cell = *rest;
    char *end = cell + strcspn(cell, ",\r\n");
    *rest = *end == ',' ? end + 1 : NULL;
    *end = '\0';
    return cell;
}

/* Which input each column feeds; how many columns there are, or less than 0. */
static int read_header(char *line, int *uses)
{
    int count = 0;
    int has_time = 0;
    for (char *rest = line; rest != NULL && count < MOST_COLUMNS; count++) {
        const char *name = next_cell(&rest);
        uses[count] = strcmp(name, "time_s") == 0 ? IS_TIME : NOT_USED;
        has_time |= uses[count] == IS_TIME;
        for (int i = 0; i < (int)INPUTS; i++) {
            if (strcmp(name, inputs_by_name[i].name) == 0) {
                uses[count] = i;
            }
        }
    }
    return has_time ? count : -1;
}

static void set_input(trackres_inputs *inputs, const struct column *column, double value)
{
    const trackres_real converted = (trackres_real)(column->scale * value);
    memcpy((char *)inputs + column->place, &converted, sizeof converted);
}

/* Fill inputs and time [s] of a row; 0 if that goes well. */
static int read_row(char *line, long number, const int *uses, int count, trackres_inputs *inputs, double *time)
{
    char *rest = line;
    *time = NAN;
    trackres_no_inputs(inputs);
    for (int i = 0; i < count; i++) {
        if (rest == NULL) {
            return wrong(number, "too few cells", line);
        }
        const char *cell = next_cell(&rest);
        if (*cell == '\0' || uses[i] == NOT_USED) {
            continue;
        }
        char *end = NULL;
        const double value = strtod(cell, &end);
        if (end == cell || *end != '\0') {
            return wrong(number, "no number", cell);
        }
        if (uses[i] == IS_TIME) {
            *time = value;
        } else {
            set_input(inputs, &inputs_by_name[uses[i]], isnan(value) ? INFINITY : value); /* which the guards refuse */
        }
    }
    return fabs(*time) < farthest_s ? 0 : wrong(number, "no time", "time_s");
}

static void write_row(int64_t stamp_ns, int64_t first_ns, const trackres_outputs *outputs)
{
    (void)printf("%.17g,%lld", (double)(stamp_ns - first_ns) * 1e-9, (long long)stamp_ns);
    for (size_t i = 0; i < (size_t)OUTPUTS; i++) {
        trackres_real value;
        memcpy(&value, (const char *)outputs + outputs_by_name[i].place, sizeof value);
        if (isnan(value)) {
            (void)printf(",");
        } else {
            (void)printf(",%.17g", (double)value);
        }
    }
    (void)printf(",%lu,%d\n", (unsigned long)outputs->reasons, (int)outputs->level);
}

static int replay(FILE *file)
{
    static char line[LONGEST_LINE];
    static int uses[MOST_COLUMNS];
    static trackres_state state;
    trackres_inputs inputs;
    trackres_inputs nothing;
    trackres_outputs outputs;
    int64_t last_ns = 0;
    int64_t first_ns = 0;
    int timed = 0;
    int begun = 0;
    memset(&outputs, 0, sizeof outputs);
    trackres_init(&state);
    trackres_no_inputs(&nothing);
    if (fgets(line, sizeof line, file) == NULL) {
        return wrong(1, "no line of names", "");
    }
    const size_t mark = strlen(utf8_mark);
    const int count = read_header(strncmp(line, utf8_mark, mark) == 0 ? line + mark : line, uses);
    if (count < 0) {
        return wrong(1, "no column", "time_s");
    }
    (void)printf("time_s,stamp_ns");
    for (size_t i = 0; i < (size_t)OUTPUTS; i++) {
        (void)printf(",%s", outputs_by_name[i].name);
    }
    (void)printf(",reasons,level\n");
    for (long number = 2; fgets(line, sizeof line, file) != NULL; number++) {
        double time = 0.0;
        if (line[strspn(line, "\r\n")] == '\0') {
            continue;
        }
        if (read_row(line, number, uses, count, &inputs, &time) != 0) {
            return 2;
        }
        const int64_t stamp_ns = (int64_t)llrint(time * 1e9);
        double dt = timed ? (double)(stamp_ns - last_ns) * 1e-9 : 0.0;
        if (dt < 0.0) {
            (void)fprintf(stderr, "trackres_replay: line %ld is earlier than the one before: not used\n", number);
            continue;
        }
        timed = 1;
        last_ns = stamp_ns;
        for (; dt > TRACKRES_LONGEST_STEP_S; dt -= TRACKRES_LONGEST_STEP_S) { /* a pause in pieces */
            (void)trackres_step(&state, &nothing, (trackres_real)TRACKRES_LONGEST_STEP_S, &outputs);
        }
        if (trackres_step(&state, &inputs, (trackres_real)dt, &outputs) == TRACKRES_STEPPED) {
            first_ns = begun ? first_ns : stamp_ns;
            begun = 1;
            write_row(stamp_ns, first_ns, &outputs);
        }
    }
    return begun ? 0 : wrong(1, "no usable speed in", "the whole file");
}

int main(int count, char **words)
{
    if (count != 2) {
        (void)fprintf(stderr, "usage: trackres_replay drive.csv > result.csv\n");
        return 2;
    }
    FILE *file = fopen(words[1], "r");
    if (file == NULL) {
        (void)fprintf(stderr, "trackres_replay: %s: %s\n", words[1], strerror(errno));
        return 2;
    }
    const int status = replay(file);
    (void)fclose(file);
    return status;
}
