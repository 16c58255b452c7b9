/* Arguments of calls from the bytes of an input: any bits, and those that matter more often than chance has them. */
#include "fuzz.h"

#include <string.h>

unsigned take_byte(bytes *from)
{
    unsigned byte = 0;
    if (from->left > 0) {
        byte = *from->at++;
        from->left--;
    }
    return byte;
}

uint64_t take_bits(bytes *from)
{
    uint64_t bits = 0;
    for (int i = 0; i < 8; i++) {
        bits = bits << 8 | take_byte(from);
    }
    return bits;
}

double take_double(bytes *from)
{
    static const double edges[] = {
        0.0,    -0.0,   1.0,          -1.0,  1e-300, 5e-324, 1e300, -1.7976931348623157e308, 9.999e8, 1e9, -1e9, 4e6,
        -3.9e6, 1.0e38, 3.4028235e38, 1e-45, 1e-38,  1e18,   4e18,  9.2233720368547758e18,   2e9,     0.1, 1e-6, 1e-9};
    const unsigned kind = take_byte(from);
    double value;
    if (kind < 64) {
        const uint64_t bits = take_bits(from);
        memcpy(&value, &bits, sizeof value);
    } else if (kind < 80) {
        const uint64_t bits = (kind & 1 ? UINT64_C(0xfff) << 52 : UINT64_C(0x7ff) << 52) | (kind & 2 ? kind : 0);
        memcpy(&value, &bits, sizeof value);
    } else if (kind < 128) {
        value = edges[kind % (sizeof edges / sizeof edges[0])];
    } else {
        static const double sizes[] = {1e-9, 1e-7, 1e-5, 1e-3, 0.01, 0.1, 1.0, 30.0};
        value = ((double)take_byte(from) - 127.5) * sizes[kind % 8];
    }
    return value;
}

machine_real take_real(bytes *from)
{
    const double value = take_double(from);
    machine_real real;
    if (take_byte(from) < 32) { /* any bits of its own */
        memcpy(&real, &value, sizeof real);
        return real;
    }
    /* beyond the range of a float the conversion is not defined */
    if (value == value && (value > 3.4028234e38 || value < -3.4028234e38)) {
        return (machine_real)(value > 0.0 ? 3.4028234e38 : -3.4028234e38);
    }
    return (machine_real)value;
}

machine_position take_position(bytes *from)
{
    const unsigned kind = take_byte(from);
    machine_position position;
    if (kind < 48) {
        const uint64_t bits = take_bits(from);
        memcpy(&position, &bits, sizeof position);
        return position;
    }
    if (kind < 96) {
        const int64_t counts = (int64_t)take_bits(from);
        const int32_t per = (int32_t)take_bits(from);
        return CALL(position_from_counts)(counts, per, (int64_t)take_bits(from));
    }
    return CALL(position_from_metres)(take_double(from));
}
