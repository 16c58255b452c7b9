/* The two functions that a compiler may call in code without a library; a firmware has its own. */
#include "helpers.h"

void *memcpy(void *to, const void *from, size_t count)
{
    unsigned char *t = to;
    const unsigned char *f = from;
    while (count-- > 0) {
        *t++ = *f++;
    }
    return to;
}

void *memset(void *to, int value, size_t count)
{
    unsigned char *t = to;
    while (count-- > 0) {
        *t++ = (unsigned char)value;
    }
    return to;
}
