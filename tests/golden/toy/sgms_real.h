/* The number type of one package, and the version of the runtime that emitted files were written
 * for.
 *
 * The runtime is a set of headers with static functions only: two packages of different precision
 * can be linked into one binary, each with a runtime of its own. SGMS_SINGLE is 0 or 1 and comes
 * from the package's config header. */
#ifndef SGMS_REAL_H
#define SGMS_REAL_H

#include <stdint.h>

#define SGMS_RUNTIME_VERSION 3

/* The code reads bits, adds and subtracts numbers to round, and asks whether numbers are finite:
 * arithmetic that compilers may rearrange gives other results, and none of it says so. Not every
 * compiler tells of each single flag (clang tells of -ffast-math and -ffinite-math-only alone), so
 * -fassociative-math, -freciprocal-math and -funsafe-math-optimizations are not to be given either.
 * Contraction (-ffp-contract) is fine. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) ||           \
    defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) ||                               \
    defined(__NO_SIGNED_ZEROS__) || defined(_M_FP_FAST)
#error "compile without -ffast-math, -Ofast or a part of them: results would be wrong in silence"
#endif

#ifndef SGMS_SINGLE
#error "define SGMS_SINGLE (0 or 1) before including the runtime"
#endif

#if SGMS_SINGLE
typedef float sgms_real;
typedef int32_t sgms_integer; /* as wide as sgms_real */
typedef uint32_t sgms_unsigned;
#define SGMS_R(x) x##f
#else
typedef double sgms_real;
typedef int64_t sgms_integer;
typedef uint64_t sgms_unsigned;
#define SGMS_R(x) x
#endif

/* Stands between what a task writes and the word that tells another task of it: the compiler moves
 * no access to memory across. Where tasks run on different cores, or with a compiler that is not
 * one of these, define it as a barrier. */
#if !defined(SGMS_FENCE) && defined(__GNUC__)
#define SGMS_FENCE() __asm__ volatile("" ::: "memory")
#elif !defined(SGMS_FENCE)
#define SGMS_FENCE() ((void)0)
#endif

/* Whether compilers find vector registers. */
#if defined(__AVX__) || defined(__SSE2__) || defined(__ARM_NEON) || defined(_M_X64)
#define SGMS_VECTORS 1
#else
#define SGMS_VECTORS 0
#endif

/* Before a loop over the lanes of one vector: gcc would unroll so short a loop before it looks for
 * vectors. */
#if defined(__GNUC__) && !defined(__clang__)
#define SGMS_LANES _Pragma("GCC unroll 1")
#else
#define SGMS_LANES
#endif

/* Before a loop of few turns whose number its caller knows: straight code, also where the compiler
 * is asked for small code. */
#if defined(__GNUC__) && !defined(__clang__) && !SGMS_VECTORS
#define SGMS_UNROLL _Pragma("GCC unroll 16")
#else
#define SGMS_UNROLL
#endif

/* The keyword of C, which C++ does not have. */
#if defined(__cplusplus) && (defined(__GNUC__) || defined(_MSC_VER))
#define SGMS_RESTRICT __restrict
#elif defined(__cplusplus)
#define SGMS_RESTRICT
#else
#define SGMS_RESTRICT restrict
#endif

/* A function that becomes part of its caller: its constants fold, and it may stand in a loop that
 * vectorises. */
#if defined(__GNUC__)
#define SGMS_INLINE __attribute__((always_inline)) inline
#else
#define SGMS_INLINE inline
#endif

/* A function that is called now and then: it is made small, and those that it calls do not become
 * part of it. */
#if defined(__GNUC__)
#define SGMS_COLD __attribute__((cold))
#else
#define SGMS_COLD
#endif

#endif
