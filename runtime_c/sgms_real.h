/* The number type of one package, and the version of the runtime that emitted files were written for.
 *
 * The runtime is a set of headers with static functions only: two packages of different precision can be linked
 * into one binary, each with a runtime of its own. SGMS_SINGLE is 0 or 1 and comes from the package's config header. */
#ifndef SGMS_REAL_H
#define SGMS_REAL_H

#include <stdint.h>

#define SGMS_RUNTIME_VERSION 1

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

/* A function whose arguments are to be constants in its body where the caller's are. */
#if defined(__GNUC__)
#define SGMS_INLINE __attribute__((always_inline)) inline
#else
#define SGMS_INLINE inline
#endif

#endif
