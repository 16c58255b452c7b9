/* What a compiler may call in code without a library. */
#ifndef SGMS_TARGET_HELPERS_H
#define SGMS_TARGET_HELPERS_H

#include <stddef.h>

void *memcpy(void *to, const void *from, size_t count);
void *memset(void *to, int value, size_t count);

#endif
