/* What comes in between: a call from an interrupt inside of another call, at any function that it enters (the package
 * is compiled with -finstrument-functions), whether the header allows it or not; and saved data of another package. */
#include "fuzz.h"

#include <string.h>

enum {
    TICK,
    SAMPLE,
    INSERT,
    PREPARE,
    FEEDBACK,
    ESTIMATE,
    SAVE,
    AHEAD,
    RESET,
    HOLD,
    SET,
    MASS_SET,
    ORIGIN,
    INIT,
    LOAD,
    KINDS
};

void __cyg_profile_func_enter(void *function, void *site);
void __cyg_profile_func_exit(void *function, void *site);

static machine *interrupted;
static bytes *arguments;
static unsigned long functions_left; /* to enter before the interrupt; 0: none comes */

/* --- saved data -------------------------------------------------------------------------------------------------- */

/* CRC-32 of all behind it, as the package's own. */
static void seal(machine_saved *saved)
{
    const unsigned char *const byte = (const unsigned char *)saved;
    uint32_t sum = UINT32_C(0xffffffff);
    for (size_t i = sizeof saved->checksum; i < sizeof *saved; i++) {
        sum ^= byte[i];
        for (int bit = 0; bit < 8; bit++) {
            sum = (sum >> 1) ^ (UINT32_C(0xedb88320) & (0u - (sum & 1u)));
        }
    }
    saved->checksum = ~sum;
}

/* Data that another package saved, whole: of another machine, of another format, as long as its own or not; or of this
 * one with any numbers, as nothing but a checksum holds them together. */
void load_others(bytes *from, machine *axis)
{
    machine_saved saved;
    const unsigned kind = take_byte(from) % 4;
    unsigned char *const byte = (unsigned char *)&saved;
    int status;
    (void)check_status(CALL(save)(axis, &saved));
    if (kind == 0) {
        saved.machine[take_byte(from) % 2] ^= 1u << take_byte(from) % 32;
    } else if (kind == 1) {
        saved.format ^= 1u << take_byte(from) % 32;
    } else if (kind == 2) { /* another layout: what lies behind its own digest, moved */
        const size_t head = offsetof(machine_saved, theta), by = sizeof(machine_real) * (1 + take_byte(from) % 4);
        memmove(byte + head, byte + head + by, sizeof saved - head - by);
        saved.machine[0] = ~saved.machine[0];
    } else {
        const unsigned count = (unsigned)((sizeof saved - offsetof(machine_saved, theta)) / sizeof(machine_real));
        for (unsigned left = 1 + take_byte(from) % 4; left > 0; left--) {
            const unsigned at = take_byte(from) % count;
            const machine_real value = take_real(from);
            memcpy(byte + offsetof(machine_saved, theta) + at * sizeof value, &value, sizeof value);
        }
    }
    seal(&saved);
    status = check_status(CALL(load)(axis, &saved));
    hold(kind == 3 || status == CONSTANT(REFUSED), "saved data of another package are taken");
    hold(status == CONSTANT(OK) || status == CONSTANT(REFUSED), "load says neither yes nor no");
}

/* --- interrupts -------------------------------------------------------------------------------------------------- */

static void call_one(unsigned kind, bytes *from, machine *axis)
{
    const int p = (int)(take_byte(from) % PARAMETERS);
    machine_signals signals = {(machine_real)0, (machine_real)0, (machine_real)0, (machine_real)1, (machine_real)1, 1,
                               (machine_real)0};
    machine_estimate estimate;
    machine_saved saved;
    switch (kind) {
    case TICK:
    case SAMPLE: {
        machine_position position = take_position(from);
        machine_real force = take_real(from);
        if (take_byte(from) % 4) {
            next_good(&position, &force);
        }
        check_force(kind == TICK ? CALL(tick)(axis, position, force) : CALL(sample)(axis, position, force));
        break;
    }
    case INSERT:
        signals.velocity = take_real(from);
        check_force(CALL(insert)(axis, &signals));
        break;
    case PREPARE:
        CALL(prepare)(axis);
        break;
    case FEEDBACK:
        (void)check_status(CALL(feedback)(axis));
        break;
    case ESTIMATE:
        CALL(estimate)(axis, &estimate);
        (void)check_status(estimate.status);
        break;
    case SAVE:
        (void)check_status(CALL(save)(axis, &saved));
        break;
    case AHEAD:
        CALL(ahead)(axis, take_real(from), (machine_real)0);
        break;
    case RESET:
        CALL(reset)(axis);
        break;
    case HOLD:
        (void)check_status(CALL(hold)(axis, p, (int)take_byte(from) % 2));
        break;
    case SET:
        CALL(estimate)(axis, &estimate);
        (void)check_status(CALL(set_parameter)(axis, p, estimate.parameter[p], estimate.deviation[p]));
        break;
    case MASS_SET:
        (void)check_status(CALL(set_mass)(axis, MASS));
        break;
    case ORIGIN:
#if HAS_ORIGIN
        (void)check_status(CALL(set_origin)(axis, take_position(from)));
#endif
        break;
    case INIT:
        CALL(init)(axis);
        break;
    default:
        (void)check_status(CALL(save)(axis, &saved));
        (void)check_status(CALL(load)(axis, &saved));
        break;
    }
    calls++;
}

void __cyg_profile_func_enter(void *function, void *site)
{
    (void)function;
    (void)site;
    if (functions_left > 0 && --functions_left == 0) {
        call_one(take_byte(arguments) % KINDS, arguments, interrupted);
    }
}

void __cyg_profile_func_exit(void *function, void *site)
{
    (void)function;
    (void)site;
}

/* Any calls inside of any others: a number of them, at places that a generator draws. */
void interrupt_call(bytes *from, machine *axis)
{
    const unsigned rounds = 1 + take_byte(from) % 64;
    uint32_t random = (uint32_t)take_bits(from) | 1u;
    interrupted = axis;
    for (unsigned round = 0; round < rounds; round++) {
        uint8_t drawn[48];
        bytes own = {drawn, sizeof drawn};
        for (unsigned i = 0; i < sizeof drawn; i++) {
            random ^= random << 13;
            random ^= random >> 17;
            random ^= random << 5;
            drawn[i] = (uint8_t)(random >> 12);
        }
        {
            const unsigned outer = take_byte(&own), place = take_byte(&own);
            arguments = &own;
            functions_left = 1 + (place < 128 ? place : place * place / 8);
            call_one(outer % 4 ? outer % (FEEDBACK + 1) : outer % KINDS, &own, axis);
            functions_left = 0;
        }
    }
}
