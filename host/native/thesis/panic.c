#include "base/panic.h"

#include <stdio.h>
#include <stdlib.h>

_Noreturn void panic(const char *where) {
    (void)fprintf(stderr, "tailbeat: a requirement of the laws failed at %s\n", where);
    abort();
}
