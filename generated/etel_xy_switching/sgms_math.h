/* Elementary functions without a library, branch-free where they run in lanes, so that compilers
 * vectorise them without relaxed arithmetic. Error bounds, tested over the whole stated range:
 *
 *   function      range               double             single
 *   sgms_exp      x <= 709 (88)       5e-16 relative     2e-7 relative
 *   exp2_core     |x| <= 1000 (120)   8e-13 relative     3e-7 relative
 *   sgms_tanh     |x| <= 1e16 (1e8)   3e-15 absolute     8e-7 absolute
 *   sgms_sin/cos  |x| <= 1e6 (1e3)    2e-15 absolute     3e-7 absolute; beyond, still within +-1
 *   sgms_log      x > 0, normal       4e-16 (1 + |log|)  3e-7 (1 + |log|)
 *   sgms_sqrt     x > 0, normal       3e-16 relative     2e-7 relative
 *   inverse_sqrt                      6e-16 relative     3e-7 relative
 *
 * Ranges of single precision stand in brackets. exp is 0 below -700 (-86) and stays at exp(709)
 * (exp(88)) beyond; the clamp of tanh cancels beyond its range; sqrt is 0 where x is not above 0,
 * NaN included. */
#ifndef SGMS_MATH_H
#define SGMS_MATH_H

#include "sgms_real.h"

/* The bits of a number, and back: a copy, which compilers vectorise, where they know it. */
#if defined(__GNUC__)
static inline sgms_integer sgms_bits(sgms_real x)
{
    sgms_integer bits;
    __builtin_memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline sgms_real sgms_from_bits(sgms_integer bits)
{
    sgms_real x;
    __builtin_memcpy(&x, &bits, sizeof x);
    return x;
}
#else
typedef union {
    sgms_real value;
    sgms_integer bits;
} sgms_pun;

static inline sgms_integer sgms_bits(sgms_real x)
{
    sgms_pun pun;
    pun.value = x;
    return pun.bits;
}

static inline sgms_real sgms_from_bits(sgms_integer bits)
{
    sgms_pun pun;
    pun.bits = bits;
    return pun.value;
}
#endif

#if SGMS_SINGLE
#define SGMS_INTEGER_MAX INT32_MAX
#define SGMS_MANTISSA_BITS 23
#define SGMS_EXPONENT_BIAS 127
#define SGMS_ROUND_MAGIC 12582912.0f /* 1.5 2^23: adding it rounds to the nearest integer */
#define SGMS_LN2_HI 0.693145751953125f
#define SGMS_LN2_LO 1.42860682030941723212e-6f
#define SGMS_EXP_LOWEST (-86.0f)
#define SGMS_EXP_HIGHEST 88.0f
#define SGMS_TANH_SATURATED 10.0f
#define SGMS_ROUNDING 1e-5f
#define SGMS_SMALLEST FLT_MIN /* normal number */
#define SGMS_EPSILON FLT_EPSILON
#else
#define SGMS_INTEGER_MAX INT64_MAX
#define SGMS_MANTISSA_BITS 52
#define SGMS_EXPONENT_BIAS 1023
#define SGMS_ROUND_MAGIC 6755399441055744.0 /* 1.5 2^52 */
#define SGMS_LN2_HI 6.93147180369123816490e-01
#define SGMS_LN2_LO 1.90821492927058770002e-10
#define SGMS_EXP_LOWEST (-700.0)
#define SGMS_EXP_HIGHEST 709.0
#define SGMS_TANH_SATURATED 20.0
#define SGMS_ROUNDING 1e-13
#define SGMS_SMALLEST DBL_MIN /* normal number */
#define SGMS_EPSILON DBL_EPSILON
#endif

/* The built-in function is one instruction; the bits go through integer registers. */
static inline sgms_real sgms_fabs(sgms_real x)
{
#if defined(__GNUC__) && SGMS_SINGLE
    return __builtin_fabsf(x);
#elif defined(__GNUC__)
    return __builtin_fabs(x);
#else
    return sgms_from_bits(sgms_bits(x) & SGMS_INTEGER_MAX);
#endif
}

static inline sgms_real sgms_square(sgms_real x)
{
    return x * x;
}

/* -1, 0 or 1, by integer comparisons, which vectorise. */
static inline sgms_real sgms_sign(sgms_real x)
{
    const sgms_integer bits = sgms_bits(x);
    const sgms_integer size = bits & SGMS_INTEGER_MAX;
    return sgms_from_bits(((bits ^ size) | sgms_bits(SGMS_R(1.0))) & -(sgms_integer)(size != 0));
}

/* |a| with the sign of b */
static inline sgms_real sgms_copy_sign(sgms_real a, sgms_real b)
{
    return sgms_from_bits((sgms_bits(a) & SGMS_INTEGER_MAX) | (sgms_bits(b) & ~SGMS_INTEGER_MAX));
}

/* All ones where a < b, b not negative, else zero. The bits of such numbers are in the order of the
 * numbers, and vectorise; where nothing does, the numbers themselves are cheaper. */
static inline sgms_integer sgms_less(sgms_real a, sgms_real b)
{
#if SGMS_VECTORS
    return -(sgms_integer)(sgms_bits(a) < sgms_bits(b));
#else
    return -(sgms_integer)(a < b);
#endif
}

/* All ones where the sign bits agree. */
static inline sgms_integer sgms_same_sign(sgms_real a, sgms_real b)
{
    return -(sgms_integer)((sgms_bits(a) ^ sgms_bits(b)) >= 0);
}

/* a where the mask is all ones, b where it is zero. */
static inline sgms_real sgms_select(sgms_integer mask, sgms_real a, sgms_real b)
{
#if SGMS_VECTORS
    return sgms_from_bits((sgms_bits(a) & mask) | (sgms_bits(b) & ~mask));
#else
    return mask ? a : b;
#endif
}

static inline sgms_real sgms_fmax(sgms_real a, sgms_real b)
{
    return a > b ? a : b;
}

static inline sgms_real sgms_fmin(sgms_real a, sgms_real b)
{
    return a < b ? a : b;
}

/* a >= 0 with the sign of b */
static inline sgms_real sgms_signed(sgms_real a, sgms_real b)
{
    return sgms_from_bits(sgms_bits(a) | (sgms_bits(b) & ~SGMS_INTEGER_MAX));
}

/* x >= 0, but no more than a positive limit; x within +-limit. Comparisons of bits vectorise; where
 * nothing does, those of numbers are cheaper, and come to the same. */
static inline sgms_real sgms_at_most(sgms_real x, sgms_real limit)
{
#if SGMS_VECTORS
    return sgms_from_bits(sgms_bits(x) < sgms_bits(limit) ? sgms_bits(x) : sgms_bits(limit));
#else
    return x < limit ? x : limit;
#endif
}

static inline sgms_real sgms_within(sgms_real x, sgms_real limit)
{
#if SGMS_VECTORS
    return sgms_signed(sgms_at_most(sgms_fabs(x), limit), x);
#else
    return x > limit ? limit : x < -limit ? -limit : x;
#endif
}

static inline sgms_real sgms_not(sgms_real x)
{
    return (sgms_real)(x == SGMS_R(0.0));
}

/* Whether x is neither infinite nor NaN. */
static inline int sgms_is_finite(sgms_real x)
{
    return x - x == SGMS_R(0.0);
}

/* True if numbers are those of IEEE 754 in this build, on this processor as it is set: a NaN
 * differs from itself, subnormals are numbers, sums are taken one after the other, to the nearest
 * number of their own precision. No macro says all of it. The numbers are volatile: no compiler
 * knows them. */
static inline SGMS_COLD int sgms_has_ieee_numbers(void)
{
    volatile sgms_real zero = SGMS_R(0.0), one = SGMS_R(1.0), part = SGMS_R(0.3),
                       smallest = SGMS_SMALLEST;
    const sgms_real none = zero / zero, unit = one, rest = part, least = smallest;
    /* 0, 0 and epsilon */
    const sgms_real whole = (rest + SGMS_ROUND_MAGIC) - SGMS_ROUND_MAGIC;
    const sgms_real down = (unit + SGMS_R(0.5) * SGMS_EPSILON) - unit;
    const sgms_real up = (unit + SGMS_R(0.75) * SGMS_EPSILON) - unit;
    return !(none == none) && least * SGMS_R(0.5) > SGMS_R(0.0) &&
           whole + down + up == SGMS_EPSILON;
}

/* x, with what is too small to matter (against 1e-20) rounded away: sensitivities of a sliding
 * element decay without end, and many processors are slow on subnormal numbers. */
static inline sgms_real sgms_drop_tiny(sgms_real x)
{
    return (x + SGMS_R(1e-20)) - SGMS_R(1e-20);
}

/* exp(x), result in the normal range; minimax polynomials on |f| <= ln(2)/2, 2e-16 and 2e-9. */
static inline sgms_real sgms_exp_core(sgms_real x)
{
    const sgms_real shifted = x * SGMS_R(1.44269504088896340736) + SGMS_ROUND_MAGIC;
    const sgms_real n = shifted - SGMS_ROUND_MAGIC;
    const sgms_real f = (x - n * SGMS_LN2_HI) - n * SGMS_LN2_LO;
    sgms_unsigned scaled;
    sgms_real p;
#if SGMS_SINGLE
    p = 0.0013836846f;
    p = p * f + 0.0083748158f;
    p = p * f + 0.041668226f;
    p = p * f + 0.1666642f;
    p = p * f + 0.49999992f;
    p = p * f + 1.0f;
    p = p * f + 1.0f;
#else
    p = 2.7488446194124013e-07;
    p = p * f + 2.7639768183381513e-06;
    p = p * f + 2.480191768015792e-05;
    p = p * f + 0.0001984117138442271;
    p = p * f + 0.0013888888499146296;
    p = p * f + 0.008333333384665614;
    p = p * f + 0.04166666666842598;
    p = p * f + 0.16666666666557742;
    p = p * f + 0.49999999999997286;
    p = p * f + 1.0000000000000064;
    p = p * f + 1.0;
#endif
    /* The low bits of `shifted` hold n; unsigned arithmetic moves it into the exponent of p. */
    scaled = (sgms_unsigned)sgms_bits(p) +
             ((sgms_unsigned)sgms_bits(shifted) << SGMS_MANTISSA_BITS);
    return sgms_from_bits((sgms_integer)scaled);
}

/* 2^x, result in the normal range; for inner loops, shorter than exp. */
static inline sgms_real sgms_exp2_core(sgms_real x)
{
    const sgms_real shifted = x + SGMS_ROUND_MAGIC;
    const sgms_real f = x - (shifted - SGMS_ROUND_MAGIC);
    sgms_unsigned scaled;
    sgms_real p;
#if SGMS_SINGLE
    p = 0.00132764726f;
    p = p * f + 0.00967554134f;
    p = p * f + 0.0555071327f;
    p = p * f + 0.240221197f;
    p = p * f + 0.693146967f;
    p = p * f + 1.00000007f;
#else
    p = 1.31758588214245891e-6;
    p = p * f + 1.5309737294734561e-5;
    p = p * f + 1.5403851744514194e-4;
    p = p * f + 0.00133334520627917774;
    p = p * f + 0.00961812854287040984;
    p = p * f + 0.0555041093934108908;
    p = p * f + 0.240226506988803226;
    p = p * f + 0.693147180546514336;
    p = p * f + 0.999999999999762349;
#endif
    scaled = (sgms_unsigned)sgms_bits(p) +
             ((sgms_unsigned)sgms_bits(shifted) << SGMS_MANTISSA_BITS);
    return sgms_from_bits((sgms_integer)scaled);
}

static inline sgms_real sgms_exp(sgms_real x)
{
    if (x < SGMS_EXP_LOWEST) {
        return SGMS_R(0.0);
    }
    return sgms_exp_core(x > SGMS_EXP_HIGHEST ? SGMS_EXP_HIGHEST : x);
}

/* The same, as sgms_lane_sin and sgms_lane_cos are: no branch keeps a loop over lanes from vectors.
 * Where nothing vectorises branches are cheaper. NaN stays one. */
static inline sgms_real sgms_lane_exp(sgms_real x)
{
#if SGMS_VECTORS
    const sgms_integer is_number = -(sgms_integer)(x == x);
    const sgms_integer is_low = sgms_less(-SGMS_EXP_LOWEST, -x) & is_number;
    const sgms_integer is_high = sgms_less(SGMS_EXP_HIGHEST, x) & is_number;
    const sgms_real core = sgms_exp_core(sgms_select(is_high, SGMS_EXP_HIGHEST, x));
    return sgms_select(is_low, SGMS_R(0.0), core);
#else
    return sgms_exp(x);
#endif
}

/* tanh(x) = 1 - 2 / (1 + exp(2 x)); the clamp is written with absolute values because compilers
 * refuse to vectorise a selection without relaxed arithmetic. */
static inline sgms_real sgms_tanh(sgms_real x)
{
    const sgms_real twice = sgms_fabs(x + SGMS_TANH_SATURATED) - sgms_fabs(x - SGMS_TANH_SATURATED);
    return SGMS_R(1.0) - SGMS_R(2.0) / (SGMS_R(1.0) + sgms_exp_core(twice));
}

/* An integer of an axis's memory as an index, 0 to most. One that damage has put beyond is 0:
 * whatever the memory holds, no index leaves it. */
static inline int sgms_place(int32_t value, int most)
{
    return value >= 0 && value <= most ? (int)value : 0;
}

/* A number as an index, 0 to most; what is no number is 0. */
static inline int sgms_index(sgms_real x, int most)
{
    if (x > SGMS_R(0.0)) {
        if (x < (sgms_real)most) {
            return (int)x;
        }
        return most;
    }
    return 0;
}

/* 1 / sqrt(x) from an estimate of the exponent and Newton steps, x as for the root. */
static inline sgms_real sgms_inverse_sqrt(sgms_real x)
{
    sgms_real y;
#if SGMS_SINGLE
    y = sgms_from_bits((sgms_integer)(UINT32_C(0x5f3759df) - ((sgms_unsigned)sgms_bits(x) >> 1)));
#else
    y = sgms_from_bits(
        (sgms_integer)(UINT64_C(0x5fe6eb50c7b537a9) - ((sgms_unsigned)sgms_bits(x) >> 1)));
    y = y * (SGMS_R(1.5) - SGMS_R(0.5) * x * y * y);
#endif
    y = y * (SGMS_R(1.5) - SGMS_R(0.5) * x * y * y);
    y = y * (SGMS_R(1.5) - SGMS_R(0.5) * x * y * y);
    return y * (SGMS_R(1.5) - SGMS_R(0.5) * x * y * y);
}

static inline sgms_real sgms_sqrt(sgms_real x)
{
    sgms_real y, root;
    if (!(x > SGMS_R(0.0))) {
        return SGMS_R(0.0);
    }
    y = sgms_inverse_sqrt(x);
    root = x * y;
    return root + SGMS_R(0.5) * y * (x - root * root);
}

/* What is left of an argument without its multiples of pi/2. Arguments so large that they have no
 * digits left leave more than pi/4, and a polynomial at such a place is as large as one likes. */
static inline sgms_real sgms_reduced(sgms_real f)
{
    return f > SGMS_R(1.0) ? SGMS_R(1.0) : f < SGMS_R(-1.0) ? SGMS_R(-1.0) : f;
}

/* x less n pi/2, in three parts */
static inline sgms_real sgms_rest(sgms_real x, sgms_real n)
{
#if SGMS_SINGLE
    return ((x - n * 1.5703125f) - n * 4.837512969970703e-4f) - n * 7.549789954891895e-8f;
#else
    return ((x - n * 1.57079632673412561417) - n * 6.07710050630396597660e-11) -
           n * 2.02226624879595063154e-21;
#endif
}

/* sin(f) and cos(f), |f| <= pi/4 */
static inline sgms_real sgms_sine_near(sgms_real f)
{
    const sgms_real f2 = f * f;
#if SGMS_SINGLE
    return f + f * f2 * (-1.6666654611e-1f + f2 * (8.3321608736e-3f + f2 * -1.9515295891e-4f));
#else
    return f + f * f2 *
                   (-1.66666666666666324348e-01 +
                    f2 * (8.33333333332248946124e-03 +
                          f2 * (-1.98412698298579493134e-04 +
                                f2 * (2.75573137070700676789e-06 +
                                      f2 * (-2.50507602534068634195e-08 +
                                            f2 * 1.58969099521155010221e-10)))));
#endif
}

static inline sgms_real sgms_cosine_near(sgms_real f)
{
    const sgms_real f2 = f * f;
#if SGMS_SINGLE
    return 1.0f + f2 * (-0.5f + f2 * (4.166664568298827e-2f +
                                      f2 * (-1.388731625493765e-3f + f2 * 2.443315711809948e-5f)));
#else
    return 1.0 + f2 * (-0.5 + f2 * (4.16666666666666019037e-02 +
                                    f2 * (-1.38888888888741095749e-03 +
                                          f2 * (2.48015872894767294178e-05 +
                                                f2 * (-2.75573143513906633035e-07 +
                                                      f2 * (2.08757232129817482790e-09 +
                                                            f2 * -1.13596475577881948265e-11))))));
#endif
}

/* sin(x + quadrant pi/2): the low bits of `shifted` hold the multiple of pi/2 that is nearest. */
static inline sgms_real sgms_sine(sgms_real x, int quadrant)
{
    const sgms_real shifted = x * SGMS_R(0.63661977236758134308) + SGMS_ROUND_MAGIC;
    const sgms_real f = sgms_reduced(sgms_rest(x, shifted - SGMS_ROUND_MAGIC));
    const int q = (int)(sgms_bits(shifted) & 3) + quadrant;
    const sgms_real p = (q & 1) != 0 ? sgms_cosine_near(f) : sgms_sine_near(f);
    return (q & 2) != 0 ? -p : p;
}

static inline sgms_real sgms_lane_sine(sgms_real x, int quadrant)
{
#if SGMS_VECTORS
    const sgms_real shifted = x * SGMS_R(0.63661977236758134308) + SGMS_ROUND_MAGIC;
    const sgms_real rest = sgms_rest(x, shifted - SGMS_ROUND_MAGIC);
    const sgms_integer is_number = -(sgms_integer)(rest == rest);
    const sgms_real f = sgms_select(is_number, sgms_within(rest, SGMS_R(1.0)), rest);
    const sgms_integer q = (sgms_bits(shifted) & 3) + quadrant;
    const sgms_real p = sgms_select(-(q & 1), sgms_cosine_near(f), sgms_sine_near(f));
    return sgms_from_bits(sgms_bits(p) ^ (-((q >> 1) & 1) & ~SGMS_INTEGER_MAX));
#else
    return sgms_sine(x, quadrant);
#endif
}

static inline sgms_real sgms_sin(sgms_real x)
{
    return sgms_sine(x, 0);
}

static inline sgms_real sgms_cos(sgms_real x)
{
    return sgms_sine(x, 1);
}

static inline sgms_real sgms_lane_sin(sgms_real x)
{
    return sgms_lane_sine(x, 0);
}

static inline sgms_real sgms_lane_cos(sgms_real x)
{
    return sgms_lane_sine(x, 1);
}

/* log(x) = e ln 2 + 2 atanh(s), s = (m - 1) / (m + 1), m in [sqrt(1/2), sqrt(2)); |s| <= 0.172 */
static inline sgms_real sgms_log(sgms_real x)
{
    sgms_real m, s, s2, series;
    const sgms_unsigned bits = (sgms_unsigned)sgms_bits(x);
    int e = (int)(bits >> SGMS_MANTISSA_BITS) - SGMS_EXPONENT_BIAS;
    const sgms_unsigned of_m = bits - ((sgms_unsigned)(sgms_integer)e << SGMS_MANTISSA_BITS);
    m = sgms_from_bits((sgms_integer)of_m);
    if (m > SGMS_R(1.41421356237309504880)) {
        m *= SGMS_R(0.5);
        e += 1;
    }
    s = (m - SGMS_R(1.0)) / (m + SGMS_R(1.0));
    s2 = s * s;
#if SGMS_SINGLE
    series = 0.3333333333f + s2 * (0.2f + s2 * (0.1428571429f + s2 * 0.1111111111f));
#else
    series = 1.0 / 3.0 +
             s2 * (1.0 / 5.0 +
                   s2 * (1.0 / 7.0 +
                         s2 * (1.0 / 9.0 +
                               s2 * (1.0 / 11.0 +
                                     s2 * (1.0 / 13.0 +
                                           s2 * (1.0 / 15.0 + s2 * (1.0 / 17.0 + s2 / 19.0)))))));
#endif
    return (sgms_real)e * SGMS_LN2_HI +
           (SGMS_R(2.0) * s + (SGMS_R(2.0) * s * s2 * series + (sgms_real)e * SGMS_LN2_LO));
}

#endif
