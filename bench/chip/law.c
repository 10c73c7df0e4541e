/*
 * The law on the fish's processor, over the longest trial: law.c and, for comparison, the same with
 * every operation made. bench/law_cost.py puts LAWS in front of it, the laws to measure. Marks the
 * begin and the end of each update.
 */
#include "ilc/law.h"
#include "law_plain.h"

#define BEATS 512u

void panic(const char *where);

_Noreturn void panic(const char *where) {
    (void)where;
    for (;;) {
    }
}

static const law_t laws[] = {LAWS};
static number_t error_m_s[BEATS], amplitude_rad[BEATS], plain_rad[BEATS], scratch[BEATS];
static uint8_t measured[BEATS], visits[BEATS];
static uint32_t random_state;

/* 0 to 1 */
static number_t uniform(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return (number_t)(random_state >> 8) * NUMBER(1.0 / 16777216.0);
}

static void make_trial(uint32_t j) {
    for (uint32_t k = 0; k < BEATS; k++) {
        error_m_s[k] = NUMBER(0.02) * uniform() - NUMBER(0.01);
        amplitude_rad[k] = NUMBER(0.3) + NUMBER(0.3) * uniform();
        plain_rad[k] = amplitude_rad[k];
        measured[k] = uniform() > NUMBER(0.02);
        visits[k] = (uint8_t)(8u + j + (k > BEATS / 2u));
    }
}

void program(void) {
    const law_trial_t trial = {BEATS, error_m_s, measured, visits};
    law_report_t report;
    random_state = 1;
    for (uint32_t j = 0; j < sizeof laws / sizeof laws[0]; j++) {
        make_trial(j);
        MARK = j;
        const law_result_t result = law_update(&laws[j], &trial, amplitude_rad, scratch, &report);
        MARK = j;
        plain_update(&laws[j], &trial, plain_rad, scratch, &report);
        MARK = j;
        uint32_t differ = result != LAW_OK;
        for (uint32_t k = 0; k < BEATS; k++) {
            differ += amplitude_rad[k] != plain_rad[k];
        }
        MARK = differ;
    }
}
