/* The console's line, by what the host sends back; rings that are too small; line speeds. */
#include "report.h"

#include "hal/clock.h"

#include <string.h>

#define BLOCKS 4u
#define ECHO_MAX_US 5000000u

#define FLOOD_BYTES 12288u
#define FLOOD_US 2000000u /* more than it takes at 115200 baud, and a slow host's time */
#define QUIET_US 200000u

#define STRAY '#' /* what no answer holds: the host looks for it */
#define LEFT_BYTES 8u
#define TOO_MANY_BYTES 64u

#define BAUD_AT_BOOT 115200u

static uint64_t passed_us(const suite_t *suite) {
    return hal_time_us(suite->hal) - suite->progress.since_us;
}

static void enter(suite_t *suite, uint32_t phase) {
    suite->progress.phase = phase;
    suite->progress.since_us = hal_time_us(suite->hal);
}

static void begin_quietly(suite_t *suite) { (void)suite; }

/* serial_write */

static bool refuses_too_much(suite_t *suite, hal_port_t port) {
    const size_t space = hal_serial_write_space(suite->hal, port);
    return hal_serial_write(suite->hal, port, suite->block, space + 1u) == 0;
}

/* A line of answers leaves less room than the next write needs; the host ignores "fill". */
static bool refuses_in_a_full_ring(suite_t *suite) {
    const size_t length = suite->console.idle_space - LEFT_BYTES;
    memset(suite->block, '.', length);
    memcpy(suite->block, "fill ", 5);
    suite->block[length - 1u] = '\n';
    const bool taken =
        hal_serial_write(suite->hal, HAL_PORT_CONSOLE, suite->block, length) == length;
    memset(suite->block, STRAY, TOO_MANY_BYTES);
    return taken &&
           hal_serial_write(suite->hal, HAL_PORT_CONSOLE, suite->block, TOO_MANY_BYTES) == 0;
}

static void report_refusals(suite_t *suite) {
    uint32_t refused = 0;
    memset(suite->block, STRAY, sizeof suite->block);
    for (unsigned port = 0; port < HAL_PORT_COUNT; port++) {
        refused += refuses_too_much(suite, (hal_port_t)port) ? 1u : 0u;
    }
    report_cases(suite, "serial_write_whole_or_none", refused, HAL_PORT_COUNT,
                 "a write of more than the free space was taken in part");
}

static bool step_write(suite_t *suite) {
    if (!console_idle(&suite->console, suite->hal)) {
        return false;
    }
    if (suite->progress.phase == 0) {
        if (suite->console.idle_space >= SUITE_BLOCK_BYTES) {
            report_absent(suite, "serial_write_whole_or_none", "the ring exceeds 4096 bytes");
            return true;
        }
        report_refusals(suite);
        suite->progress.phase = 1;
        return false;
    }
    report_cases(suite, "serial_full_ring", refuses_in_a_full_ring(suite) ? 1u : 0u, 1,
                 "a write without room was taken, or one with room refused");
    return true;
}

const scenario_t serial_write_scenario = {"serial_write", begin_quietly, step_write};

/* serial_baud: of the IMU's port, so that the console keeps its speed. */

static bool step_baud(suite_t *suite) {
    static const uint32_t impossible[] = {0, 1, 50, 100000000, UINT32_MAX};
    const uint32_t count = sizeof impossible / sizeof impossible[0];
    uint32_t refused = 0;
    for (uint32_t i = 0; i < count; i++) {
        refused += !hal_serial_set_baud(suite->hal, HAL_PORT_IMU, impossible[i]) ? 1u : 0u;
    }
    report_cases(suite, "serial_baud_impossible", refused, count,
                 "a line speed was accepted that no port can keep");
    const bool accepted = hal_serial_set_baud(suite->hal, HAL_PORT_IMU, BAUD_AT_BOOT);
    report_cases(suite, "serial_baud_at_boot", accepted ? 1u : 0u, 1, "115200 baud was refused");
    return true;
}

const scenario_t serial_baud_scenario = {"serial_baud", begin_quietly, step_baud};

/* loopback: "echo N", N bytes; the host sends them back. */

enum { ANNOUNCE = 0, SEND, HEAR };

/* All values of a byte in each 256. */
static uint8_t pattern(uint32_t block, uint32_t at) {
    return (uint8_t)(at * 7u + block * 31u + (at >> 8));
}

static void begin_loopback(suite_t *suite) {
    suite->progress.errors = hal_serial_errors(suite->hal, HAL_PORT_CONSOLE);
}

static uint32_t echo_bytes(const suite_t *suite) {
    const size_t ring = suite->console.idle_space;
    return (uint32_t)(ring < SUITE_BLOCK_BYTES ? ring : SUITE_BLOCK_BYTES);
}

static void send_block(suite_t *suite, uint32_t block) {
    const uint32_t length = echo_bytes(suite);
    for (uint32_t i = 0; i < length; i++) {
        suite->block[i] = pattern(block, i);
    }
    const size_t taken = hal_serial_write(suite->hal, HAL_PORT_CONSOLE, suite->block, length);
    suite->progress.wrong += taken == length ? 0 : length;
}

static void hear_block(suite_t *suite, uint32_t block) {
    progress_t *progress = &suite->progress;
    uint8_t bytes[64];
    size_t length = 0;
    while ((length = hal_serial_read(suite->hal, HAL_PORT_CONSOLE, bytes, sizeof bytes)) > 0) {
        for (size_t i = 0; i < length; i++) {
            progress->total += bytes[i] == pattern(block, progress->most++) ? 1u : 0u;
        }
    }
}

static void report_loopback(suite_t *suite) {
    const progress_t *progress = &suite->progress;
    const hal_serial_errors_t errors = hal_serial_errors(suite->hal, HAL_PORT_CONSOLE);
    const uint32_t all = BLOCKS * echo_bytes(suite);
    const uint64_t right = progress->wrong == 0 ? progress->total : 0;
    report_range(suite, "serial_loopback", right, "bytes", all, all,
                 "bytes that the host sent back are lost or differ");
    report_range(suite, "serial_loopback_errors",
                 errors.overruns - progress->errors.overruns + errors.framing -
                     progress->errors.framing,
                 "errors", 0, 0, "the port counted errors");
}

/* |done| blocks are through; |most| bytes of the present one are heard. */
static bool step_loopback(suite_t *suite) {
    progress_t *progress = &suite->progress;
    if (progress->phase != HEAR && !console_idle(&suite->console, suite->hal)) {
        return false;
    }
    if (progress->phase == ANNOUNCE) {
        report_request(suite, "echo", echo_bytes(suite));
        enter(suite, SEND);
        return false;
    }
    if (progress->phase == SEND) {
        send_block(suite, progress->done);
        progress->most = 0;
        enter(suite, HEAR);
    }
    hear_block(suite, progress->done);
    if (progress->most < echo_bytes(suite) && passed_us(suite) < ECHO_MAX_US) {
        return false;
    }
    progress->done++;
    enter(suite, ANNOUNCE);
    if (progress->done < BLOCKS) {
        return false;
    }
    report_loopback(suite);
    return true;
}

const scenario_t loopback_scenario = {"loopback", begin_loopback, step_loopback};

/* overrun: "flood N"; the host sends N bytes that nobody takes in time. */

enum { REQUEST = 0, IGNORE, DRAIN };

static uint32_t drain(suite_t *suite) {
    uint32_t taken = 0;
    size_t length = 0;
    while ((length = hal_serial_read(suite->hal, HAL_PORT_CONSOLE, suite->block,
                                     sizeof suite->block)) > 0) {
        taken += (uint32_t)length;
    }
    return taken;
}

static void report_overrun(suite_t *suite) {
    const progress_t *progress = &suite->progress;
    const hal_serial_errors_t errors = hal_serial_errors(suite->hal, HAL_PORT_CONSOLE);
    const uint32_t lost = errors.overruns - progress->errors.overruns;
    if (progress->done == FLOOD_BYTES && lost == 0) {
        report_absent(suite, "serial_overrun_counted", "the ring holds all 12288 bytes");
        return;
    }
    report_range(suite, "serial_overrun_counted", progress->done + lost, "bytes", FLOOD_BYTES,
                 FLOOD_BYTES, "bytes taken and overruns counted do not add up to those sent");
    report_range(suite, "serial_overrun_lost", lost, "bytes", 1, FLOOD_BYTES,
                 "no overrun was counted");
}

static bool step_overrun(suite_t *suite) {
    progress_t *progress = &suite->progress;
    if (progress->phase == REQUEST) {
        report_request(suite, "flood", FLOOD_BYTES);
        enter(suite, IGNORE);
        return false;
    }
    if (progress->phase == IGNORE && passed_us(suite) < FLOOD_US) {
        return false;
    }
    const uint32_t taken = drain(suite);
    progress->done += taken;
    if (progress->phase == IGNORE || taken > 0) {
        enter(suite, DRAIN);
    }
    if (passed_us(suite) < QUIET_US) {
        return false;
    }
    report_overrun(suite);
    return true;
}

const scenario_t overrun_scenario = {"overrun", begin_loopback, step_overrun};
