/* The larger or smaller of two as Python has it: the first, unless the second is larger or smaller. */
static @REAL@ tr_max_real(@REAL@ a, @REAL@ b)
{
    return b > a ? b : a;
}

static @REAL@ tr_min_real(@REAL@ a, @REAL@ b)
{
    return b < a ? b : a;
}

static int64_t tr_max_int(int64_t a, int64_t b)
{
    return b > a ? b : a;
}

static int64_t tr_min_int(int64_t a, int64_t b)
{
    return b < a ? b : a;
}

static int64_t tr_abs_int(int64_t a)
{
    return a < 0 ? -a : a;
}

/* Without its fraction; 0 of what is no number, or too large for a whole one. */
static int64_t tr_whole(@REAL@ a)
{
    return a > @REAL_LEAST@ && a < @REAL_MOST@ ? (int64_t)a : 0;
}

/* The same; of no such number `failed` is set, where Python raises an error. */
static int64_t tr_whole_number(@REAL@ a, bool *failed)
{
    const bool known = a > @REAL_LEAST@ && a < @REAL_MOST@;
    *failed = *failed || !known;
    return known ? (int64_t)a : 0;
}

/* A place as Python counts it, from the end if negative; of none of them the first, and `failed` is set. */
static int64_t tr_place(int64_t place, int64_t length, bool *failed)
{
    const int64_t found = place < 0 ? place + length : place;
    const bool known = found >= 0 && found < length;
    *failed = *failed || !known;
    return known ? found : 0;
}

/* Quotient and rest as Python has them: towards minus infinity, with the sign of the divisor. By 0 as numpy has them. */
static int64_t tr_floored_int(int64_t a, int64_t b)
{
    if (b == 0) {
        return 0;
    }
    const int64_t towards_zero = a / b;
    return a % b != 0 && (a < 0) != (b < 0) ? towards_zero - 1 : towards_zero;
}

static int64_t tr_modulo_int(int64_t a, int64_t b)
{
    if (b == 0) {
        return 0;
    }
    const int64_t rest = a % b;
    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;
}

static @REAL@ tr_floored_real(@REAL@ a, @REAL@ b)
{
    if (b == 0) {
        return a / b;
    }
    const @REAL@ rest = @FMOD@(a, b);
    const @REAL@ quotient = (a - rest) / b - (rest != 0 && (rest < 0) != (b < 0));
    const @REAL@ floored = @FLOOR@(quotient);
    return quotient - floored > @HALF@ ? floored + 1 : floored;
}

static @REAL@ tr_modulo_real(@REAL@ a, @REAL@ b)
{
    const @REAL@ rest = @FMOD@(a, b);
    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;
}
