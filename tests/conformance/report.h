/* Answers of a scenario: one line per check. */
#ifndef CONFORMANCE_REPORT_H
#define CONFORMANCE_REPORT_H

#include "suite.h"

/* "check NAME VALUE UNIT LEAST MOST ok", or "... failed WHY" when |value| is out of range. */
void report_range(suite_t *suite, const char *name, uint64_t value, const char *unit,
                  uint64_t least, uint64_t most, const char *why);

/* |right| of |all| cases went as hal/include/hal says. */
void report_cases(suite_t *suite, const char *name, uint32_t right, uint32_t all, const char *why);

/* "check NAME - - - - absent WHY": this board cannot do it. */
void report_absent(suite_t *suite, const char *name, const char *why);

/* Asks the host for something: "KEYWORD NUMBER". */
void report_request(suite_t *suite, const char *keyword, uint64_t number);

#endif
