/* The bare step of four belts: their temperatures and the torque, and nothing else. No guards, no uncertainty, no status, no other
 * output. Tables and constants come from bare_vehicle.h, which bench_step.py writes: BELTS, ROWS, COLUMNS, and the values below. */
#include "bare_vehicle.h"

#include <math.h>

struct bare {
    double temperature[BELTS]; /* [degC] */
    double log_load[BELTS];
    double load[BELTS]; /* [N] */
    double weight;      /* [N] */
    double ambient;     /* [degC] */
    double speed;       /* of the last step [m/s] */
    double driving;     /* drive torque of the last step [Nm] */
};

static double within(double value, double most)
{
    return value < 0.0 ? 0.0 : value > most ? most : value;
}

/* The loss [N] of a belt at a place on the axis of reduced speed, with its drive torque; its slope along the axis. */
static double loss_at(const struct bare *b, int belt, double x, double drive, double *slope)
{
    const double u = within((x - FIRST_X) / STEP_X, ROWS - 1.000001);
    const double w = within((b->log_load[belt] - FIRST_LOG_LOAD[belt]) / STEP_LOG_LOAD[belt], COLUMNS - 1.000001);
    const int i = (int)u, j = (int)w, table = TABLE[belt];
    const double *low = LOSS[table][i], *high = LOSS[table][i + 1];
    const double *signed_low = DRIVE[table][i], *signed_high = DRIVE[table][i + 1];
    const double before = low[j] + (w - j) * (low[j + 1] - low[j]);
    const double after = high[j] + (w - j) * (high[j + 1] - high[j]);
    const double with_sign = signed_low[0] + (u - i) * (signed_high[0] - signed_low[0]);
    const double by_size = signed_low[1] + (u - i) * (signed_high[1] - signed_low[1]);
    *slope = (after - before) / STEP_X;
    return before + (u - i) * (after - before) + drive * with_sign + fabs(drive) * by_size;
}

static double shift_of(double degc, double *slope)
{
    const double above = degc - GLASS_TRANSITION, span = WLF_C2 - 50.0;
    if (above >= 0.0) {
        *slope = -WLF_C1 * WLF_C2 / ((span + above) * (span + above));
        return -WLF_C1 * (above - 50.0) / (span + above);
    }
    *slope = -WLF_C1 * WLF_C2 / (span * span);
    return WLF_C1 * 50.0 / span + *slope * above;
}

static void bare_begin(struct bare *b)
{
    b->weight = b->speed = b->driving = 0.0;
    b->ambient = AMBIENT;
    for (int i = 0; i < BELTS; i++) {
        b->temperature[i] = AMBIENT;
        b->load[i] = LOAD[i];
        b->log_load[i] = log(LOAD[i]);
        b->weight += LOAD[i];
    }
}

/* The resistance torque [Nm] after a step of a time [s] to a new speed [m/s]. */
static double bare_step(struct bare *b, double speed, double dt)
{
    const double middle = 0.5 * fabs(b->speed + speed), sign = tanh(speed / STANDSTILL);
    const double log_middle = log10(fmax(middle, 1e-6)), log_speed = log10(fmax(fabs(speed), 1e-6));
    double own = 0.0, arm = 0.0, shift_slope, slope;
    for (int i = 0; i < BELTS; i++) {
        const double share = b->load[i] / b->weight, drive = b->driving * share;
        double shift = shift_of(b->temperature[i], &shift_slope);
        const double force = loss_at(b, i, shift + log_middle, drive, &slope);
        const double cooling = (FILM_OFFSET[i] + FILM_SLOPE[i] * middle) * AREA[i];
        const double growth = (slope * shift_slope * middle - cooling) / CAPACITY[i];
        const double rate = (force * middle - cooling * (b->temperature[i] - b->ambient)) / CAPACITY[i];
        b->temperature[i] += rate * expm1(growth * dt) / growth;
        shift = shift_of(b->temperature[i], &shift_slope);
        own += RADIUS[i] * loss_at(b, i, shift + log_speed, drive, &slope) * sign;
        arm += RADIUS[i] * share;
    }
    const double resistance = own + arm * (FRICTION * b->weight * sign + DRAG * speed * fabs(speed));
    b->driving = resistance + arm * INERTIA * b->weight * (speed - b->speed) / dt;
    b->speed = speed;
    return resistance;
}

#ifdef FOR_PYTHON
#define Py_LIMITED_API 0x030B0000
#include <Python.h>

static struct bare bare;

/* step(speed, dt): the torque, as a number of Python. */
static PyObject *step(PyObject *Py_UNUSED(self), PyObject *const *given, Py_ssize_t Py_UNUSED(count))
{
    return PyFloat_FromDouble(bare_step(&bare, PyFloat_AsDouble(given[0]), PyFloat_AsDouble(given[1])));
}

static PyMethodDef methods[] = {{"step", (PyCFunction)(void (*)(void))step, METH_FASTCALL, NULL}, {NULL, NULL, 0, NULL}};
static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, "bare", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_bare(void)
{
    bare_begin(&bare);
    return PyModule_Create(&module);
}
#endif
