/* Lists the suites of unit tests, or runs the one that is named. One per process, as they have
 * static variables. Exit status: the number of failed tests; 2 and a line on stderr for a suite
 * that does not exist. */
#include "suites.h"

#include <stdio.h>
#include <string.h>

static const suite_t *chosen;

void setUp(void);
void tearDown(void);

/* Unity calls these around each test. */
void setUp(void) { chosen->set_up(); }
void tearDown(void) { chosen->tear_down(); }

int main(int argc, char **argv) {
    for (const suite_t *suite = suites; suite->name != NULL; suite++) {
        if (argc < 2) {
            puts(suite->name);
        } else if (strcmp(suite->name, argv[1]) == 0) {
            chosen = suite;
            return suite->main(argc, argv);
        }
    }
    if (argc >= 2) {
        fprintf(stderr, "there is no suite %s\n", argv[1]);
        return 2;
    }
    return 0;
}
