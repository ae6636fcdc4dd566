/* Takes the arguments of entries from Python: numbers, arrays and records of these. */

struct tr_held {
    int used;
    Py_buffer views[TR_MOST_VIEWS];
};

static void tr_release(struct tr_held *held)
{
    while (held->used > 0) {
        held->used--;
        PyBuffer_Release(&held->views[held->used]);
    }
}

static void tr_free_bound(PyObject *capsule)
{
    struct tr_held *held = PyCapsule_GetPointer(capsule, PyCapsule_GetName(capsule));
    tr_release(held);
    PyMem_Free(held);
}

static bool tr_counted(Py_ssize_t given, Py_ssize_t wanted, const char *name)
{
    if (given != wanted) {
        PyErr_Format(PyExc_TypeError, "%s takes %zd arguments, %zd are given", name, wanted, given);
    }
    return given == wanted;
}

static bool tr_is_record(PyObject *given, Py_ssize_t wanted, const char *name)
{
    if (!PyTuple_Check(given) || PyTuple_Size(given) != wanted) {
        PyErr_Format(PyExc_TypeError, "%s is a tuple of %zd", name, wanted);
        return false;
    }
    return true;
}

static bool tr_real(PyObject *given, double *found)
{
    *found = PyFloat_AsDouble(given);
    return *found != -1.0 || !PyErr_Occurred();
}

static bool tr_int(PyObject *given, int64_t *found)
{
    *found = PyLong_AsLongLong(given);
    return *found != -1 || !PyErr_Occurred();
}

static bool tr_truth(PyObject *given, bool *found)
{
    const int truth = PyObject_IsTrue(given);
    *found = truth > 0;
    return truth >= 0;
}

static bool tr_is_of(const Py_buffer *view, char kind, int axes, const int64_t *shape)
{
    const char *format = view->format == NULL ? "B" : view->format;
    const bool known = format[0] == kind || (kind == 'l' && format[0] == 'q');
    if (!known || format[1] != '\0' || view->ndim != axes) {
        return false;
    }
    for (int axis = 0; axis < axes; axis++) {
        if (shape[axis] >= 0 && view->shape[axis] != shape[axis]) {
            return false;
        }
    }
    return true;
}

/* A contiguous copy of an array of another layout or of other numbers, for a kernel that only reads it. */
static PyObject *tr_converted(PyObject *given, char kind)
{
    const char type[2] = {kind, '\0'};
    PyObject *numpy = PyImport_ImportModule("numpy");
    PyObject *found = numpy == NULL ? NULL : PyObject_CallMethod(numpy, "ascontiguousarray", "Os", given, type);
    Py_XDECREF(numpy);
    return found;
}

/* The entries of an array, and those of its lengths that are not known before; NULL with an error. */
static void *tr_array(
    struct tr_held *held, PyObject *given, char kind, int axes, const int64_t *shape, bool writes, const char *name, int64_t *lengths)
{
    static double nothing = 0.0; /* stands for the entries of an empty array */
    Py_buffer *view = &held->views[held->used];
    const int flags = PyBUF_C_CONTIGUOUS | PyBUF_FORMAT | (writes ? PyBUF_WRITABLE : 0);
    bool taken = PyObject_GetBuffer(given, view, flags) == 0;
    if (!taken || !tr_is_of(view, kind, axes, shape)) {
        if (taken) {
            PyBuffer_Release(view);
        }
        PyErr_Clear();
        PyObject *other = writes ? NULL : tr_converted(given, kind);
        taken = other != NULL && PyObject_GetBuffer(other, view, flags) == 0;
        Py_XDECREF(other);
        if (taken && !tr_is_of(view, kind, axes, shape)) {
            PyBuffer_Release(view);
            taken = false;
        }
        if (!taken) {
            PyErr_Format(PyExc_TypeError, "%s is a contiguous array of kind %c with %d axes", name, kind, axes);
            return NULL;
        }
    }
    held->used++;
    for (int axis = 0; axis < axes; axis++) {
        if (shape[axis] < 0) {
            *lengths++ = view->shape[axis];
        }
    }
    return view->buf == NULL ? &nothing : view->buf;
}
