/*
 * The suites of unit tests that one program holds. Each was a program of its own: CMakeLists.txt
 * renames main, setUp and tearDown of every file, and writes the table.
 */
#ifndef SELFTEST_SUITES_H
#define SELFTEST_SUITES_H

typedef struct {
    const char *name;
    int (*main)(int argc, char **argv); /* most take no arguments, which does no harm */
    void (*set_up)(void);
    void (*tear_down)(void);
} suite_t;

/* Ends with a row without a name. */
extern const suite_t suites[];

#endif
