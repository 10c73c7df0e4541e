/* Checks of the tick's times that several scenarios share. */
#ifndef CONFORMANCE_TIME_CHECKS_H
#define CONFORMANCE_TIME_CHECKS_H

#include "suite.h"

/* Mean period and largest deviation from it, of the ticks since ticks_begin(). */
void time_checks_ticks(suite_t *suite, const char *period, const char *jitter);

#endif
