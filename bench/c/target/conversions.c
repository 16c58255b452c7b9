/* Conversions that the compiler's library has with the low byte first alone: of integers of 64 bits, rounded once. */
#include <stdint.h>

__attribute__((pcs("aapcs"))) double __aeabi_l2d(int64_t value);
__attribute__((pcs("aapcs"))) float __aeabi_l2f(int64_t value);
__attribute__((pcs("aapcs"))) int64_t __aeabi_d2lz(double value);

double __aeabi_l2d(int64_t value)
{
    const uint64_t bits = (uint64_t)value;
    return (double)(int32_t)(uint32_t)(bits >> 32) * 4294967296.0 + (double)(uint32_t)bits;
}

/* Beyond 53 bits the last one stands for all below it, so that the double is exact and rounds as the whole would. */
float __aeabi_l2f(int64_t value)
{
    const int is_wide = value >= INT64_C(1) << 53 || value <= -(INT64_C(1) << 53);
    const uint64_t low = UINT64_C(0x7ff), bits = (uint64_t)value;
    const uint64_t kept = is_wide ? (bits & ~low) | ((bits & low) != 0 ? low + 1 : 0) : bits;
    return (float)__aeabi_l2d((int64_t)kept);
}

/* Of magnitudes below 2^63. */
int64_t __aeabi_d2lz(double value)
{
    const double size = value < 0.0 ? -value : value;
    const uint32_t high = (uint32_t)(size / 4294967296.0);
    const uint32_t low = (uint32_t)(size - (double)high * 4294967296.0);
    const int64_t whole = (int64_t)((uint64_t)high << 32 | low);
    return value < 0.0 ? -whole : whole;
}
