/* Names of a package: JOIN(etel_xy, tick) is etel_xy_tick, and so is CALL(tick) with -DSGMS_MACHINE=etel_xy. */
#ifndef JOINED_H
#define JOINED_H

#define JOIN2(a, b) a##_##b
#define JOIN(a, b) JOIN2(a, b)
#define CALL(name) JOIN(SGMS_MACHINE, name)

#endif
