/* Watchdog, crash record, battery, LED. */
#include "report.h"

#include "base/panic.h"
#include "hal/clock.h"

#include <string.h>

#define WATCHDOG_MAX_US 5000000u
#define CRASH_PLACE "conformance/crash.c:42" /* the host looks for it */

#define SAMPLES 50u
#define STEADY (HAL_BATTERY_SCALE / 100u)

static void begin_quietly(suite_t *suite) { (void)suite; }

/* Once per tick. */
static bool tick_passed(suite_t *suite) {
    const bool passed = ticks_count(&suite->ticks) > suite->progress.done;
    suite->progress.done += passed ? 1u : 0u;
    return passed;
}

static void begin_ticks(suite_t *suite) { ticks_begin(&suite->ticks, suite->hal); }

/* watchdog */

static void begin_watchdog(suite_t *suite) {
    report_request(suite, "starving", WATCHDOG_MAX_US / 1000000u);
}

/* A board whose watchdog bites does not come to the report. */
static bool step_watchdog(suite_t *suite) {
    suite->starving = true;
    if (hal_time_us(suite->hal) - suite->progress.since_us < WATCHDOG_MAX_US) {
        return false;
    }
    suite->starving = false;
    report_cases(suite, "watchdog_bites", 0, 1, "no restart after 5 s without a feed");
    return true;
}

const scenario_t watchdog_scenario = {"watchdog", begin_watchdog, step_watchdog};

/* crash, a restart, crash_record, crash_forget */

static void begin_crash(suite_t *suite) { report_request(suite, "crashing", 1); }

/* The answers have left by then. */
static bool step_crash(suite_t *suite) {
    if (!console_idle(&suite->console, suite->hal)) {
        return false;
    }
    panic(CRASH_PLACE);
}

const scenario_t crash_scenario = {"crash", begin_crash, step_crash};

static bool names_place(const hal_crash_t *crash) {
    const size_t length = sizeof CRASH_PLACE - 1u;
    const size_t room = sizeof crash->where - 1u;
    return crash->kind == HAL_CRASH_ASSERTION && length <= room &&
           memcmp(crash->where, CRASH_PLACE, length + 1u) == 0;
}

static bool step_record(suite_t *suite) {
    hal_crash_t crash;
    const bool there = hal_crash_read(suite->hal, &crash);
    report_cases(suite, "crash_record_there", there ? 1u : 0u, 1,
                 "no crash record after a failed assertion");
    report_cases(suite, "crash_record_place", there && names_place(&crash) ? 1u : 0u, 1,
                 "the record does not name the assertion's place");
    return true;
}

const scenario_t crash_record_scenario = {"crash_record", begin_quietly, step_record};

static bool step_forget(suite_t *suite) {
    hal_crash_t crash;
    hal_crash_forget(suite->hal);
    const bool there = hal_crash_read(suite->hal, &crash);
    report_cases(suite, "crash_record_forgotten", there ? 0 : 1u, 1,
                 "the crash record is still there after hal_crash_forget");
    return true;
}

const scenario_t crash_forget_scenario = {"crash_forget", begin_quietly, step_forget};

/* battery */

static void report_battery(suite_t *suite) {
    const progress_t *progress = &suite->progress;
    report_range(suite, "battery_reading", progress->total / SAMPLES, "65536ths", 1,
                 HAL_BATTERY_SCALE - 2u, "the reading is at an end of its range");
    report_range(suite, "battery_steady", progress->most - progress->least, "65536ths", 0, STEADY,
                 "the reading changes by more than 1 % of full scale within a second");
}

static bool step_battery(suite_t *suite) {
    progress_t *progress = &suite->progress;
    if (!tick_passed(suite)) {
        return false;
    }
    const uint16_t reading = hal_battery_reading(suite->hal);
    progress->least = reading < progress->least ? reading : progress->least;
    progress->most = reading > progress->most ? reading : progress->most;
    progress->total += reading;
    if (progress->done < SAMPLES) {
        return false;
    }
    report_battery(suite);
    return true;
}

const scenario_t battery_scenario = {"battery", begin_ticks, step_battery};

/* led: ten times on and off, one change per tick */

#define LED_CHANGES 20u

static bool step_led(suite_t *suite) {
    if (!tick_passed(suite)) {
        return false;
    }
    hal_led_isr(suite->hal, suite->progress.done % 2u == 1u);
    if (suite->progress.done < LED_CHANGES) {
        return false;
    }
    report_range(suite, "led_called", LED_CHANGES, "calls", LED_CHANGES, LED_CHANGES, "");
    return true;
}

const scenario_t led_scenario = {"led", begin_ticks, step_led};
