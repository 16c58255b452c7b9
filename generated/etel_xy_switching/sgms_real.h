/* The number type of one package, and the version of this runtime.
 *
 * The runtime is a set of headers with static functions only: two packages of different precision
 * can be linked into one binary. SGMS_SINGLE is 0 or 1, from the package's config header. */
#ifndef SGMS_REAL_H
#define SGMS_REAL_H

#include <float.h>
#include <stdbool.h>
#include <stdint.h>

#define SGMS_RUNTIME_VERSION 5

/* The code reads bits, adds and subtracts numbers to round, and checks that numbers are finite: it
 * is wrong where compilers may rearrange arithmetic. Clang reports -ffast-math and
 * -ffinite-math-only alone: sgms_has_ieee_numbers() notices others, as it runs. Contraction
 * (-ffp-contract) is fine. */
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__) ||           \
    defined(__ASSOCIATIVE_MATH__) || defined(__RECIPROCAL_MATH__) ||                               \
    defined(__NO_SIGNED_ZEROS__) || defined(_M_FP_FAST)
#error "compile without -ffast-math, -Ofast or a part of them: results would be wrong in silence"
#endif

/* It also is wrong where sums are of more digits than their numbers have, as those of x87. */
#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 1 || FLT_EVAL_METHOD == 2)
#error "compile without excess precision (x86: -mfpmath=sse): results would be wrong in silence"
#endif

/* And where numbers are not those of 32 and 64 bits of IEEE 754. */
#if FLT_RADIX != 2 || FLT_MANT_DIG != 24 || FLT_MAX_EXP != 128
#error "float has to be the number of 32 bits of IEEE 754"
#elif DBL_MANT_DIG != 53 || DBL_MAX_EXP != 1024
#error "double has to be the number of 64 bits of IEEE 754: some compilers have an option for it"
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

/* Between the data that a task writes and the word that announces them: the compiler moves no
 * access to memory across. For tasks on two cores, or another compiler, define it as a barrier. */
#if !defined(SGMS_FENCE) && defined(__GNUC__)
#define SGMS_FENCE() __asm__ volatile("" ::: "memory")
#elif !defined(SGMS_FENCE) && defined(_MSC_VER)
#include <intrin.h>
#define SGMS_FENCE() _ReadWriteBarrier()
#elif !defined(SGMS_FENCE) && defined(SGMS_ONE_TASK)
#define SGMS_FENCE() ((void)0)
#elif !defined(SGMS_FENCE)
#error "define SGMS_FENCE() as a barrier to memory, or SGMS_ONE_TASK where one task calls"
#endif

/* Whether the code takes the form that compilers vectorise; results are the same to the bit. It
 * pays with wide registers (-O3 -mavx2). With those of 128 bits it pays from gcc -O3 on, if at all,
 * which a compiler does not tell: define it as 1 there. */
#if !defined(SGMS_VECTORS) && defined(__AVX__)
#define SGMS_VECTORS 1
#elif !defined(SGMS_VECTORS)
#define SGMS_VECTORS 0
#endif

/* Before a loop over the lanes of one vector, which gcc would unroll instead of vectorise. */
#if defined(__GNUC__) && !defined(__clang__)
#define SGMS_LANES _Pragma("GCC unroll 1")
#else
#define SGMS_LANES
#endif

/* Before a short loop whose length its caller knows: straight code, also at -Os. */
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

/* A function that becomes part of its caller: constants fold, loops around it vectorise. */
#if defined(__GNUC__)
#define SGMS_INLINE __attribute__((always_inline)) inline
#else
#define SGMS_INLINE inline
#endif

/* A function that is called rarely: small, with nothing inlined into it. */
#if defined(__GNUC__)
#define SGMS_COLD __attribute__((cold))
#else
#define SGMS_COLD
#endif

#endif
