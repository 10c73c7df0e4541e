/* The clock never goes back; the tick comes every 20 ms, and not while it is locked out. */
#include "time_checks.h"

#include "report.h"

#include "hal/clock.h"

#define SPAN_US 1000000u
#define READS 200u /* of the clock in one step */

#define PERIOD_US 20000u
#define PERIOD_SLACK_US 20u /* 0.1 %: tick and clock come from one oscillator */
/* A twentieth of a frame. A tick that is later than a frame makes a pulse of the wrong beat. */
#define JITTER_MAX_US 1000u

#define LOCKED_US 25000u /* longer than a frame */
#define PASSES_MAX 1000000u
#define STILL_READS 1000u /* so many reads without a microsecond: time stands still */
#define AT_ONCE_US 200u
#define AFTER_US 100000u

static uint64_t now_us(const suite_t *suite) { return hal_time_us(suite->hal); }

static uint64_t passed_us(const suite_t *suite) { return now_us(suite) - suite->progress.since_us; }

static void begin_ticks(suite_t *suite) { ticks_begin(&suite->ticks, suite->hal); }

/* clock */

static bool step_clock(suite_t *suite) {
    progress_t *progress = &suite->progress;
    uint64_t before = progress->total;
    for (uint32_t i = 0; i < READS; i++) {
        const uint64_t after = now_us(suite);
        progress->wrong += after < before ? 1u : 0u;
        before = after;
    }
    progress->total = before;
    progress->done += READS + 1u;
    const tick_times_t times = ticks_read(&suite->ticks, suite->hal);
    progress->wrong += times.last_us > now_us(suite) ? 1u : 0u;
    if (passed_us(suite) < SPAN_US) {
        return false;
    }
    report_cases(suite, "clock_monotonic", progress->done - progress->wrong, progress->done,
                 "the clock went back");
    return true;
}

const scenario_t clock_scenario = {"clock", begin_ticks, step_clock};

/* tick */

static uint32_t larger(uint32_t a, uint32_t b) { return a > b ? a : b; }

void time_checks_ticks(suite_t *suite, const char *period, const char *jitter) {
    const tick_times_t times = ticks_read(&suite->ticks, suite->hal);
    if (times.count < 2) {
        report_range(suite, period, 0, "us", PERIOD_US - PERIOD_SLACK_US,
                     PERIOD_US + PERIOD_SLACK_US, "no tick came");
        return;
    }
    const uint32_t intervals = times.count - 1u;
    const uint32_t mean = (uint32_t)((times.last_us - times.first_us + intervals / 2u) / intervals);
    report_range(suite, period, mean, "us", PERIOD_US - PERIOD_SLACK_US,
                 PERIOD_US + PERIOD_SLACK_US, "the ticks' mean period by the board's own clock");
    const uint32_t deviation = larger(times.longest_us - mean, mean - times.shortest_us);
    report_range(suite, jitter, deviation, "us", 0, JITTER_MAX_US,
                 "an interval differs from the mean period");
}

static bool step_tick(suite_t *suite) {
    if (passed_us(suite) < SPAN_US) {
        return false;
    }
    time_checks_ticks(suite, "tick_period", "tick_jitter");
    return true;
}

const scenario_t tick_scenario = {"tick", begin_ticks, step_tick};

/* lock */

static void pass_some_cycles(void) {
    for (volatile uint32_t i = 0; i < 50u; i++) {
    }
}

/* Waits in one step, as nothing else tells whether a tick comes through. False when time stands
 * still within a step, as on a simulated board: no tick can come then. */
static bool wait_us(const suite_t *suite, uint32_t duration_us) {
    const uint64_t start = now_us(suite);
    for (uint32_t pass = 0; pass < PASSES_MAX; pass++) {
        const uint64_t now = now_us(suite);
        const uint64_t waited = now > start ? now - start : 0;
        if (waited >= duration_us) {
            return true;
        }
        if (pass == STILL_READS && waited == 0) {
            return false;
        }
        pass_some_cycles();
    }
    return false;
}

/* Right after a tick: the lock lasts over the next one and ends before the one after. */
static bool lock_out(suite_t *suite) {
    hal_irq_lock(suite->hal);
    const uint32_t before = ticks_count(&suite->ticks);
    const bool waited = wait_us(suite, LOCKED_US);
    const uint32_t during = ticks_count(&suite->ticks) - before;
    hal_irq_unlock(suite->hal);
    if (!waited) {
        return false;
    }
    (void)wait_us(suite, AT_ONCE_US);
    const uint32_t at_once = ticks_count(&suite->ticks) - before - during;
    report_range(suite, "lock_keeps_tick_out", during, "ticks", 0, 0,
                 "a tick came between hal_irq_lock and hal_irq_unlock");
    report_range(suite, "lock_delays_tick", at_once, "ticks", 1, 1,
                 "exactly one tick is due when the lock ends");
    return true;
}

/* The first and the last tick were not delayed. */
static void report_number_of_ticks(suite_t *suite) {
    const tick_times_t times = ticks_read(&suite->ticks, suite->hal);
    const uint64_t span = times.last_us - times.first_us;
    const uint64_t expected = (span + PERIOD_US / 2u) / PERIOD_US + 1u;
    report_range(suite, "lock_loses_no_tick", times.count, "ticks", expected, expected,
                 "ticks were lost or doubled after the lock");
}

static bool step_lock(suite_t *suite) {
    progress_t *progress = &suite->progress;
    if (progress->phase == 0) {
        if (ticks_count(&suite->ticks) == 0) {
            return false;
        }
        progress->phase = 1;
        progress->since_us = now_us(suite);
        progress->wrong = lock_out(suite) ? 0 : 1u;
    }
    if (progress->wrong > 0) {
        static const char why[] = "time stands still while the main loop runs";
        report_absent(suite, "lock_keeps_tick_out", why);
        report_absent(suite, "lock_delays_tick", why);
        report_absent(suite, "lock_loses_no_tick", why);
        return true;
    }
    if (passed_us(suite) < AFTER_US) {
        return false;
    }
    report_number_of_ticks(suite);
    return true;
}

const scenario_t lock_scenario = {"lock", begin_ticks, step_lock};
