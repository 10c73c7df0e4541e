/* Commands, and the scenario that runs. */
#include "app/app.h"

#include "report.h"

#include "hal/clock.h"

#include <string.h>

static const scenario_t *const scenarios[] = {
    &clock_scenario,       &tick_scenario,         &lock_scenario,         &flash_bounds_scenario,
    &flash_write_scenario, &flash_keep_scenario,   &flash_kept_scenario,   &serial_write_scenario,
    &serial_baud_scenario, &loopback_scenario,     &overrun_scenario,      &watchdog_scenario,
    &crash_scenario,       &crash_record_scenario, &crash_forget_scenario, &battery_scenario,
    &led_scenario,
};
#define SCENARIOS (sizeof scenarios / sizeof scenarios[0])

static const char *reset_name(hal_reset_cause_t cause) {
    static const char *const names[] = {
        [HAL_RESET_POWER] = "power",       [HAL_RESET_BACKUP] = "backup",
        [HAL_RESET_WATCHDOG] = "watchdog", [HAL_RESET_SOFTWARE] = "software",
        [HAL_RESET_PIN] = "pin",
    };
    return (size_t)cause < sizeof names / sizeof names[0] ? names[cause] : "unknown";
}

/* "conformance 1 reset CAUSE id HEX exact 0|1 servos COUNT" */
static void say_who(suite_t *suite) {
    uint8_t id[16];
    text_t text = {.length = 0};
    hal_unique_id(suite->hal, id);
    text_word(&text, "conformance 1 reset");
    text_word(&text, reset_name(hal_reset_cause(suite->hal)));
    text_word(&text, "id");
    text_hex(&text, id, sizeof id);
    text_word(&text, "exact");
    text_number(&text, hal_clock_exact(suite->hal) ? 1u : 0u);
    text_word(&text, "servos");
    text_number(&text, HAL_SERVO_COUNT);
    console_say(&suite->console, &text);
}

static void say(suite_t *suite, const char *word, const char *name) {
    text_t text = {.length = 0};
    text_word(&text, word);
    text_word(&text, name);
    console_say(&suite->console, &text);
}

static void list(suite_t *suite) {
    for (size_t i = 0; i < SCENARIOS; i++) {
        say(suite, "scenario", scenarios[i]->name);
    }
}

static void run(suite_t *suite, const char *name) {
    for (size_t i = 0; i < SCENARIOS; i++) {
        if (strcmp(name, scenarios[i]->name) == 0) {
            suite->progress =
                (progress_t){.least = UINT32_MAX, .since_us = hal_time_us(suite->hal)};
            suite->running = scenarios[i];
            suite->running->begin(suite);
            return;
        }
    }
    say(suite, "error no scenario", name);
}

/* What is left of |line| after |word| and a space; NULL when it begins otherwise. */
static const char *after(const char *line, const char *word) {
    const size_t length = strlen(word);
    return strncmp(line, word, length) == 0 && line[length] == ' ' ? line + length + 1 : NULL;
}

/* A decimal number; |*text| is behind it and a space then. */
static uint32_t take_number(const char **text) {
    uint32_t number = 0;
    while (**text >= '0' && **text <= '9') {
        number = number * 10u + (uint32_t)(*(*text)++ - '0');
    }
    *text += **text == ' ' ? 1 : 0;
    return number;
}

/* "servo CHANNEL WIDTH", in hal_servo_pulse_isr()'s ticks. */
static void set_servo(suite_t *suite, const char *arguments) {
    const uint32_t servo = take_number(&arguments);
    const uint32_t width = take_number(&arguments);
    if (servo >= HAL_SERVO_COUNT || width > UINT16_MAX) {
        say(suite, "error no servo", "or no width");
        return;
    }
    hal_irq_lock(suite->hal);
    suite->ticks.pulse_ticks[servo] = (uint16_t)width;
    hal_irq_unlock(suite->hal);
    say(suite, "done", "servo");
}

static void execute(suite_t *suite, const char *line) {
    const char *name = after(line, "run");
    const char *servo = after(line, "servo");
    if (name != NULL) {
        run(suite, name);
    } else if (servo != NULL) {
        set_servo(suite, servo);
    } else if (strcmp(line, "list") == 0) {
        list(suite);
        say(suite, "done", "list");
    } else if (strcmp(line, "about") == 0) {
        say_who(suite);
    } else if (strcmp(line, "time") == 0) {
        report_request(suite, "time", hal_time_us(suite->hal));
    } else if (strcmp(line, "restart") == 0) {
        hal_reset(suite->hal);
    } else {
        say(suite, "error unknown command", line);
    }
}

void app_init(app_t *app, hal_t *hal) {
    memset(app, 0, sizeof *app);
    app->hal = hal;
    say_who(app);
}

static void advance(suite_t *suite) {
    if (suite->running->step(suite)) {
        say(suite, "done", suite->running->name);
        suite->running = NULL;
    }
}

void app_poll(app_t *app) {
    if (!app->starving) {
        hal_watchdog_feed(app->hal);
    }
    if (app->running != NULL) {
        advance(app);
    } else if (console_command(&app->console, app->hal)) {
        execute(app, app->console.line);
    }
    console_send(&app->console, app->hal);
}

void app_tick_isr(app_t *app) { ticks_isr(&app->ticks, app->hal); }
