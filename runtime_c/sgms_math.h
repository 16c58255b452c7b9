/* Elementary functions without a library, branch-free where they run in lanes, so that compilers vectorise them
 * without relaxed arithmetic. Error bounds, tested over the whole stated range:
 *
 *   function      range                     double            single
 *   sgms_exp      all                       4e-16 relative    2e-7 relative (underflow to 0 below -700, -86)
 *   sgms_tanh     all                       1e-15 absolute    3e-7 absolute
 *   sgms_sin/cos  |x| <= 1e5                2e-15 absolute    3e-7 absolute (|x| <= 1e3; grows with |x| beyond)
 *   sgms_log      x > 0, normal             4e-16 (1 + |log|) 3e-7 (1 + |log|)
 *   sgms_sqrt     x >= 0                    3e-16 relative    2e-7 relative
 */
#ifndef SGMS_MATH_H
#define SGMS_MATH_H

#include "sgms_real.h"

typedef union {
    sgms_real value;
    sgms_integer bits;
} sgms_pun;

#if SGMS_SINGLE
#define SGMS_MANTISSA_BITS 23
#define SGMS_EXPONENT_BIAS 127
#define SGMS_ROUND_MAGIC 12582912.0f /* 1.5 2^23: adding it rounds to the nearest integer */
#define SGMS_LN2_HI 0.693145751953125f
#define SGMS_LN2_LO 1.42860682030941723212e-6f
#define SGMS_EXP_LOWEST (-86.0f)
#define SGMS_EXP_HIGHEST 88.0f
#define SGMS_TANH_SATURATED 10.0f
#define SGMS_ROUNDING 1e-5f
#else
#define SGMS_MANTISSA_BITS 52
#define SGMS_EXPONENT_BIAS 1023
#define SGMS_ROUND_MAGIC 6755399441055744.0 /* 1.5 2^52 */
#define SGMS_LN2_HI 6.93147180369123816490e-01
#define SGMS_LN2_LO 1.90821492927058770002e-10
#define SGMS_EXP_LOWEST (-700.0)
#define SGMS_EXP_HIGHEST 709.0
#define SGMS_TANH_SATURATED 20.0
#define SGMS_ROUNDING 1e-13
#endif

static inline sgms_real sgms_fabs(sgms_real x)
{
    sgms_pun p;
    p.value = x;
#if SGMS_SINGLE
    p.bits &= INT32_MAX;
#else
    p.bits &= INT64_MAX;
#endif
    return p.value;
}

static inline sgms_real sgms_square(sgms_real x)
{
    return x * x;
}

/* -1, 0 or 1 */
static inline sgms_real sgms_sign(sgms_real x)
{
    return (sgms_real)((x > SGMS_R(0.0)) - (x < SGMS_R(0.0)));
}

static inline sgms_real sgms_fmax(sgms_real a, sgms_real b)
{
    return a > b ? a : b;
}

static inline sgms_real sgms_fmin(sgms_real a, sgms_real b)
{
    return a < b ? a : b;
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

/* exp(x) for |x| within the normal range of the result; minimax polynomials on |f| <= ln(2)/2, 2e-16 and 2e-9. */
static inline sgms_real sgms_exp_core(sgms_real x)
{
    const sgms_real shifted = x * SGMS_R(1.44269504088896340736) + SGMS_ROUND_MAGIC;
    const sgms_real n = shifted - SGMS_ROUND_MAGIC;
    const sgms_real f = (x - n * SGMS_LN2_HI) - n * SGMS_LN2_LO;
    sgms_pun scale;
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
    scale.value = shifted;
#if SGMS_SINGLE
    {
        const uint32_t exponent = (uint32_t)scale.bits << SGMS_MANTISSA_BITS;
        scale.value = p;
        scale.bits = (int32_t)((uint32_t)scale.bits + exponent);
    }
#else
    {
        const uint64_t exponent = (uint64_t)scale.bits << SGMS_MANTISSA_BITS;
        scale.value = p;
        scale.bits = (int64_t)((uint64_t)scale.bits + exponent);
    }
#endif
    return scale.value;
}

static inline sgms_real sgms_exp(sgms_real x)
{
    if (x < SGMS_EXP_LOWEST) {
        return SGMS_R(0.0);
    }
    return sgms_exp_core(x > SGMS_EXP_HIGHEST ? SGMS_EXP_HIGHEST : x);
}

/* tanh(x) = 1 - 2 / (1 + exp(2 x)); the clamp is written with absolute values because compilers refuse to
 * vectorise a selection without relaxed arithmetic. */
static inline sgms_real sgms_tanh(sgms_real x)
{
    const sgms_real twice = sgms_fabs(x + SGMS_TANH_SATURATED) - sgms_fabs(x - SGMS_TANH_SATURATED);
    return SGMS_R(1.0) - SGMS_R(2.0) / (SGMS_R(1.0) + sgms_exp_core(twice));
}

/* Square root from an estimate of the exponent and Newton steps on the reciprocal root. */
static inline sgms_real sgms_sqrt(sgms_real x)
{
    sgms_pun y;
    sgms_real root;
    if (!(x > SGMS_R(0.0))) {
        return SGMS_R(0.0);
    }
    y.value = x;
#if SGMS_SINGLE
    y.bits = 0x5f3759df - (y.bits >> 1);
#else
    y.bits = INT64_C(0x5fe6eb50c7b537a9) - (y.bits >> 1);
    y.value = y.value * (SGMS_R(1.5) - SGMS_R(0.5) * x * y.value * y.value);
#endif
    y.value = y.value * (SGMS_R(1.5) - SGMS_R(0.5) * x * y.value * y.value);
    y.value = y.value * (SGMS_R(1.5) - SGMS_R(0.5) * x * y.value * y.value);
    y.value = y.value * (SGMS_R(1.5) - SGMS_R(0.5) * x * y.value * y.value);
    root = x * y.value;
    return root + SGMS_R(0.5) * y.value * (x - root * root);
}

/* sin(x + quadrant pi/2), argument reduced by multiples of pi/2 in three parts. */
static inline sgms_real sgms_sine(sgms_real x, int quadrant)
{
    const sgms_real turns = x * SGMS_R(0.63661977236758134308);
    const sgms_real n = (turns + SGMS_ROUND_MAGIC) - SGMS_ROUND_MAGIC;
    sgms_real f, f2, p;
    int q;
#if SGMS_SINGLE
    f = ((x - n * 1.5703125f) - n * 4.837512969970703e-4f) - n * 7.549789954891895e-8f;
    q = (int)n + quadrant;
    f2 = f * f;
    if (q & 1) {
        p = 1.0f + f2 * (-0.5f + f2 * (4.166664568298827e-2f + f2 * (-1.388731625493765e-3f + f2 * 2.443315711809948e-5f)));
    } else {
        p = f + f * f2 * (-1.6666654611e-1f + f2 * (8.3321608736e-3f + f2 * -1.9515295891e-4f));
    }
#else
    f = ((x - n * 1.57079632673412561417) - n * 6.07710050630396597660e-11) - n * 2.02226624879595063154e-21;
    q = (int)n + quadrant;
    f2 = f * f;
    if (q & 1) {
        p = 1.0 +
            f2 * (-0.5 +
                  f2 * (4.16666666666666019037e-02 +
                        f2 * (-1.38888888888741095749e-03 +
                              f2 * (2.48015872894767294178e-05 +
                                    f2 * (-2.75573143513906633035e-07 +
                                          f2 * (2.08757232129817482790e-09 + f2 * -1.13596475577881948265e-11))))));
    } else {
        p = f + f * f2 *
                    (-1.66666666666666324348e-01 +
                     f2 * (8.33333333332248946124e-03 +
                           f2 * (-1.98412698298579493134e-04 +
                                 f2 * (2.75573137070700676789e-06 +
                                       f2 * (-2.50507602534068634195e-08 + f2 * 1.58969099521155010221e-10)))));
    }
#endif
    return (q & 2) ? -p : p;
}

static inline sgms_real sgms_sin(sgms_real x)
{
    return sgms_sine(x, 0);
}

static inline sgms_real sgms_cos(sgms_real x)
{
    return sgms_sine(x, 1);
}

/* log(x) = e ln 2 + 2 atanh(s), s = (m - 1) / (m + 1), m in [sqrt(1/2), sqrt(2)); |s| <= 0.172 */
static inline sgms_real sgms_log(sgms_real x)
{
    sgms_pun p;
    sgms_real s, s2, series;
    int e;
    p.value = x;
    e = (int)(p.bits >> SGMS_MANTISSA_BITS) - SGMS_EXPONENT_BIAS;
    p.bits -= (sgms_integer)e * ((sgms_integer)1 << SGMS_MANTISSA_BITS);
    if (p.value > SGMS_R(1.41421356237309504880)) {
        p.value *= SGMS_R(0.5);
        e += 1;
    }
    s = (p.value - SGMS_R(1.0)) / (p.value + SGMS_R(1.0));
    s2 = s * s;
#if SGMS_SINGLE
    series = 0.3333333333f + s2 * (0.2f + s2 * (0.1428571429f + s2 * 0.1111111111f));
#else
    series = 1.0 / 3.0 +
             s2 * (1.0 / 5.0 +
                   s2 * (1.0 / 7.0 +
                         s2 * (1.0 / 9.0 +
                               s2 * (1.0 / 11.0 + s2 * (1.0 / 13.0 + s2 * (1.0 / 15.0 + s2 * (1.0 / 17.0 + s2 / 19.0)))))));
#endif
    return (sgms_real)e * SGMS_LN2_HI + (SGMS_R(2.0) * s + (SGMS_R(2.0) * s * s2 * series + (sgms_real)e * SGMS_LN2_LO));
}

#endif
