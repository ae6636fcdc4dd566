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

/* Quotient and rest as Python has them: towards minus infinity, with the sign of the divisor. */
static int64_t tr_floored_int(int64_t a, int64_t b)
{
    const int64_t towards_zero = a / b;
    return a % b != 0 && (a < 0) != (b < 0) ? towards_zero - 1 : towards_zero;
}

static int64_t tr_modulo_int(int64_t a, int64_t b)
{
    const int64_t rest = a % b;
    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;
}

static @REAL@ tr_floored_real(@REAL@ a, @REAL@ b)
{
    return @FLOOR@(a / b);
}

static @REAL@ tr_modulo_real(@REAL@ a, @REAL@ b)
{
    const @REAL@ rest = @FMOD@(a, b);
    return rest != 0 && (rest < 0) != (b < 0) ? rest + b : rest;
}
