#include "imu/driver.h"

#include "base/panic.h"
#include "imu/frame.h"

#include <string.h>

#define BASE_RATE_HZ 800u /* of the sensor's samples, divided for output */
#define BITS_PER_BYTE 10u /* 8N1 */
#define SAVE_TIMEOUT_US 1200000u
#define SETTLE_US 5000u /* for the sensor to follow a change of speed */
#define REST_US 1000000u
#define FIRST_FRAME_MARGIN_US 150000u
#define FIRST_FRAME_MAX_US 1050000u
#define PATIENCE_MIN_US 500000u
/* A pass of the main loop may come 150 ms late, and a stream is missed only after PATIENCE_MIN_US.
 */
#define VERDICT_MARGIN_US (150000u + PATIENCE_MIN_US)
#define REPLY_TYPICAL_BYTES 64u
#define MILLION 1000000u
#define ROWS_ALL ((1u << IMU_ROWS) - 1u)
#define READ_CHARS 8u /* VNRRG,75 */
/* A speed at which nothing was heard is not worth a third try. */
#define TRIES_UNHEARD 2u

enum {
    ERROR_BUFFER_OVERFLOW = 2,
    ERROR_CHECKSUM = 3,
    ERROR_WATCHDOG = 10,
    ERROR_OUTPUT_OVERFLOW = 11,
    ERROR_BAUD_TOO_LOW = 12,
    ERROR_TOO_MANY = 255,
};

/* In this order: a baud rate can be lowered, and a binary output accepted, only while the sum of
 * all output of the port fits. */
typedef enum {
    STEP_FIND,
    STEP_PAUSE,
    STEP_FIRMWARE,
    STEP_ASCII_OFF,
    STEP_BINARY_1_OFF,
    STEP_BINARY_2_OFF,
    STEP_BINARY_3_OFF,
    STEP_BAUD,
    STEP_HEADING,
    STEP_MOUNT,
    STEP_WINDOW,
    STEP_OUTPUT,
    STEP_RESUME,
    STEP_SAVE_ACCEL,
    STEP_SAVE_RATE,
    STEP_SAVE_MOUNT,
    STEP_SAVE,
    STEP_RESTART,
} step_t;

/* Small letters stand for numbers (number_for), m for a mounting, c for a calibration. */
static const char *const COMMANDS[] = {
    [STEP_FIND] = "VNRRG,01",
    [STEP_PAUSE] = "VNASY,0",
    [STEP_FIRMWARE] = "VNRRG,04",
    [STEP_ASCII_OFF] = "VNWRG,06,0",
    [STEP_BINARY_1_OFF] = "VNWRG,7k,p,d,11,0129,0040",
    [STEP_BINARY_2_OFF] = "VNWRG,7k,p,d,11,0129,0040",
    [STEP_BINARY_3_OFF] = "VNWRG,7k,p,d,11,0129,0040",
    [STEP_BAUD] = "VNWRG,05,b",
    [STEP_HEADING] = "VNWRG,35,e,h,f,t",
    [STEP_MOUNT] = "VNWRG,26,m",
    [STEP_WINDOW] = "VNWRG,85,0,d,d,4,0,0,3,3,3,0",
    [STEP_OUTPUT] = "VNWRG,7k,p,d,11,0129,0040",
    [STEP_RESUME] = "VNASY,1",
    [STEP_SAVE_ACCEL] = "VNWRG,25,c,0,0,0",
    [STEP_SAVE_RATE] = "VNWRG,84,c,0,0,0",
    [STEP_SAVE_MOUNT] = "VNWRG,26,m",
    [STEP_SAVE] = "VNWNV",
    [STEP_RESTART] = "VNRST",
};

/* Sensor axes to fish axes, row by row. */
static const char *const MOUNTS[] = {
    "1,0,0,0,1,0,0,0,1",  "1,0,0,0,-1,0,0,0,-1", "-1,0,0,0,-1,0,0,0,1",
    "0,-1,0,1,0,0,0,0,1", "0,1,0,-1,0,0,0,0,1",
};

/* Likeliest first. */
static const uint32_t BAUDS[] = {115200, 460800, 230400, 921600, 57600, 38400, 19200, 9600, 128000};
#define BAUD_COUNT (sizeof BAUDS / sizeof BAUDS[0])

typedef enum {
    PHASE_LOOK, /* read; write only what differs */
    PHASE_SEND, /* write, or what has no second phase */
    PHASE_VERIFY,
} phase_t;

const char *imu_problem_meaning(imu_problem_t problem) {
    static const char *const MEANINGS[] = {
#define IMU_PROBLEM(name, number, meaning, remedy) [number] = meaning,
#include "imu/problems.def"
#undef IMU_PROBLEM
    };
    REQUIRE((size_t)problem < sizeof MEANINGS / sizeof MEANINGS[0]);
    return MEANINGS[problem];
}

static bool baud_known(uint32_t baud) {
    for (size_t i = 0; i < BAUD_COUNT; i++) {
        if (BAUDS[i] == baud) {
            return true;
        }
    }
    return false;
}

bool imu_driver_config_valid(const imu_driver_config_t *config) {
    return config->rate_hz != 0 && BASE_RATE_HZ % config->rate_hz == 0 &&
           baud_known(config->baud) &&
           config->rate_hz * IMU_FRAME_BYTES * BITS_PER_BYTE <= config->baud && config->port <= 2 &&
           config->heading >= -1 && config->heading <= 2 &&
           config->mount <= sizeof MOUNTS / sizeof MOUNTS[0];
}

static uint32_t period_us(const imu_driver_config_t *config) { return 1000000u / config->rate_hz; }

uint32_t imu_driver_patience_us(const imu_driver_config_t *config) {
    const uint32_t slow_us = 2u * period_us(config) + FIRST_FRAME_MARGIN_US;
    return slow_us > PATIENCE_MIN_US ? slow_us : PATIENCE_MIN_US;
}

/* Times wrap around every 71 minutes; none lies that far away. */
static bool reached(const imu_driver_t *driver, uint32_t time_us) {
    return driver->now_us - time_us <= INT32_MAX;
}

static uint32_t number_for(const imu_driver_t *driver, char letter) {
    const bool off = driver->step != STEP_OUTPUT;
    switch (letter) {
    case 'b':
        return driver->config.baud;
    case 'd':
        return BASE_RATE_HZ / driver->config.rate_hz;
    case 'k':
        return off ? 5u + driver->step - STEP_BINARY_1_OFF : 5u;
    case 'p':
        return off ? 0 : driver->port;
    case 'e':
        return driver->vpe[0];
    case 'h':
        return (uint32_t)driver->config.heading;
    case 'f':
        return driver->vpe[2];
    default:
        return driver->vpe[3];
    }
}

static char *put_number(char *at, uint32_t value) {
    char digits[10];
    size_t count = 0;
    do {
        digits[count++] = (char)('0' + value % 10u);
        value /= 10u;
    } while (value != 0);
    while (count != 0) {
        *at++ = digits[--count];
    }
    return at;
}

static char *put_millionths(char *at, int32_t millionths) {
    const uint32_t size = (uint32_t)(millionths < 0 ? -millionths : millionths);
    if (millionths < 0) {
        *at++ = '-';
    }
    char *end = put_number(at, size + MILLION); /* 7 digits or 8, the first is one too much */
    memmove(end - 5, end - 6, 6);
    at[0] = (char)(at[0] - 1);
    at[1] = '.';
    return end + 1;
}

static char *put_rows(const imu_driver_t *driver, char *at) {
    const unsigned first = driver->step == STEP_SAVE_RATE ? 3 : 0;
    for (unsigned i = 0; i < 9; i++) {
        at = put_millionths(at, driver->row_millionths[first + i / 3][i % 3]);
        *at++ = ',';
    }
    return at - 1;
}

/* The step's command as it is to be echoed, or for a read as it is to be answered. */
static uint16_t wanted(const imu_driver_t *driver, char *out) {
    char *at = out;
    for (const char *c = COMMANDS[driver->step]; *c != 0; c++) {
        if (*c == 'm') {
            const char *mount = MOUNTS[driver->config.mount - 1u];
            const size_t length = strlen(mount);
            memcpy(at, mount, length);
            at += length;
        } else if (*c == 'c') {
            at = put_rows(driver, at);
        } else if (*c >= 'a') {
            at = put_number(at, number_for(driver, *c));
        } else {
            *at++ = *c;
        }
    }
    if (driver->phase != PHASE_SEND) {
        out[2] = 'R';
    }
    return (uint16_t)(at - out);
}

/* Leaves of a number what counts: no leading zeros, no fraction of zeros, no sign. True = it is
 * below zero. */
static bool trim(imu_text_t *text) {
    const char *begin = text->chars, *end = begin + text->length;
    if (memchr(begin, '.', text->length) != NULL) {
        while (end[-1] == '0') {
            end--;
        }
        end -= end[-1] == '.';
    }
    const bool minus = begin != end && *begin == '-';
    while (begin != end && (*begin == '0' || *begin == '+' || *begin == '-')) {
        begin++;
    }
    *text = (imu_text_t){begin, (uint16_t)(end - begin)};
    return minus && begin != end;
}

/* Whether that field is the same number, in any notation of the sensor's, decimal or hexadecimal.
 */
static bool same_field(const imu_text_t *body, const imu_text_t *want, unsigned number) {
    imu_text_t given = imu_line_field(*body, number), right = imu_line_field(*want, number);
    if (given.length == 0) {
        return false;
    }
    const bool given_minus = trim(&given);
    const bool right_minus = trim(&right);
    return given_minus == right_minus && given.length == right.length &&
           memcmp(given.chars, right.chars, given.length) == 0;
}

/* As many values as |want| has; the sensor may append more. */
static bool same_values(const imu_driver_t *driver, const imu_text_t *body,
                        const imu_text_t *want) {
    const bool off = driver->step >= STEP_BINARY_1_OFF && driver->step <= STEP_BINARY_3_OFF;
    const bool rows = driver->step == STEP_SAVE_ACCEL || driver->step == STEP_SAVE_RATE;
    /* What an output that is off would hold is the sensor's affair, as are the digits of a
     * calibration. */
    const unsigned fields = rows ? 2u : off ? 3u : imu_line_fields(*want);
    unsigned same = 2;
    while (same < fields && same_field(body, want, same)) {
        same++;
    }
    return same >= fields;
}

/* Whether it answers what was sent, not something before. */
static bool answers(const imu_text_t *body, const imu_text_t *want) {
    return body->length >= IMU_LINE_TYPE_CHARS &&
           memcmp(body->chars, want->chars, IMU_LINE_TYPE_CHARS) == 0 &&
           (want->length == IMU_LINE_TYPE_CHARS || same_field(body, want, 1));
}

static imu_check_t check_for(const imu_driver_t *driver) {
    /* A sensor set to the other check may be silent about wrong ones. */
    const bool guess = driver->step == STEP_FIND && driver->tries == 1 && !driver->heard;
    const imu_check_t other = driver->check == IMU_CHECK_XOR8 ? IMU_CHECK_CRC16 : IMU_CHECK_XOR8;
    return guess ? other : driver->check;
}

static void send(imu_driver_t *driver, imu_action_t *action) {
    /* Whatever else stands in its input buffer, from another speed or a damaged line, ends here. */
    const bool clear = driver->step == STEP_FIND || driver->tries != 0;
    char *begin = driver->command + 2;
    memcpy(driver->command, "\r\n$", 3);
    uint16_t length = wanted(driver, begin + 1);
    if (driver->phase != PHASE_SEND) {
        length = READ_CHARS;
    }
    length = imu_line_seal(begin, (uint16_t)(length + 1u), check_for(driver));
    if (clear) {
        begin = driver->command;
        length = (uint16_t)(length + 2u);
    }
    const uint32_t line_us =
        (2u * length + REPLY_TYPICAL_BYTES) * (BITS_PER_BYTE * 1000000u) / driver->line_baud;
    driver->deadline_us = driver->now_us + line_us +
                          (driver->step == STEP_SAVE ? SAVE_TIMEOUT_US : IMU_REPLY_TIMEOUT_US);
    driver->sent = true;
    action->what = IMU_DO_SEND;
    action->bytes = begin;
    action->length = length;
}

static void go_to_phase(imu_driver_t *driver, phase_t phase) {
    driver->phase = (uint8_t)phase;
    driver->tries = 0;
    driver->sent = false;
    driver->deadline_us = driver->now_us;
}

static void enter(imu_driver_t *driver, step_t step) {
    const bool look = step == STEP_HEADING || step == STEP_MOUNT;
    driver->step = (uint8_t)step;
    go_to_phase(driver, look ? PHASE_LOOK : PHASE_SEND);
}

static void listen_at(imu_driver_t *driver, uint8_t index) {
    driver->baud_index = index;
    driver->target_baud = index == 0 ? driver->config.baud : BAUDS[index - 1u];
    driver->heard = false;
    enter(driver, STEP_FIND);
}

static void search(imu_driver_t *driver) {
    driver->state = IMU_SEARCHING;
    listen_at(driver, 0);
}

static void next_baud(imu_driver_t *driver) {
    uint32_t index = driver->baud_index + 1u;
    if (index <= BAUD_COUNT && BAUDS[index - 1u] == driver->config.baud) {
        index++;
    }
    listen_at(driver, (uint8_t)(index <= BAUD_COUNT ? index : 0));
}

static void state_problem(imu_driver_t *driver, imu_problem_t problem) {
    driver->problem = problem;
    driver->verdict_us = driver->now_us + IMU_DRIVER_VERDICT_US - VERDICT_MARGIN_US;
    driver->bytes_seen = 0;
    driver->messages_seen = 0;
    driver->answered = false;
}

static void begin(imu_driver_t *driver) {
    state_problem(driver, IMU_PROBLEM_STARTING);
    search(driver);
}

/* Starts over, but without flooding the line. */
static void conclude(imu_driver_t *driver, imu_problem_t problem) {
    state_problem(driver, problem);
    search(driver);
    driver->deadline_us = driver->now_us + REST_US;
}

/* Since it was set up: whole ones or not. */
static bool frames_came(const imu_driver_t *driver) {
    return driver->bytes_seen >= IMU_FRAME_BYTES;
}

static imu_problem_t verdict(const imu_driver_t *driver) {
    if (driver->state == IMU_WAITING) {
        return frames_came(driver) ? IMU_PROBLEM_NOISY : IMU_PROBLEM_WRONG_PORT;
    }
    if (driver->answered) {
        return IMU_PROBLEM_NOISY;
    }
    if (driver->messages_seen != 0) {
        return IMU_PROBLEM_NO_REPLY;
    }
    return driver->bytes_seen != 0 ? IMU_PROBLEM_UNREADABLE : IMU_PROBLEM_SILENT;
}

/* It has one output: the port tried before falls silent. */
static bool try_other_port(imu_driver_t *driver) {
    if (driver->config.port != 0 || driver->both_ports) {
        return false;
    }
    driver->both_ports = true;
    driver->port = (uint8_t)(3u - driver->port);
    driver->state = IMU_CONFIGURING;
    enter(driver, STEP_OUTPUT);
    return true;
}

/* |why| matters when the tries are used up. Damage is no verdict by itself: another round may do.
 */
static void fail(imu_driver_t *driver, imu_problem_t why) {
    const bool finding = driver->step == STEP_FIND;
    driver->tries++;
    driver->sent = false;
    driver->deadline_us = driver->now_us;
    if (driver->tries < (finding && !driver->heard ? TRIES_UNHEARD : IMU_TRIES)) {
        driver->retries++;
    } else if (finding) {
        next_baud(driver);
    } else if (why == IMU_PROBLEM_NOISY) {
        search(driver);
    } else if (driver->step != STEP_OUTPUT || why != IMU_PROBLEM_BAUD_TOO_LOW) {
        conclude(driver, why);
    } else if (!try_other_port(driver)) { /* ours is fast enough: it is another that is too slow */
        conclude(driver, IMU_PROBLEM_WRONG_PORT);
    }
}

static bool needed(const imu_driver_t *driver, unsigned step) {
    switch (step) {
    case STEP_BAUD:
        return driver->line_baud != driver->config.baud;
    case STEP_HEADING:
        return driver->config.heading >= 0;
    case STEP_MOUNT:
        return driver->config.mount != 0;
    case STEP_SAVE_MOUNT:
        return driver->needs_save;
    default:
        return true;
    }
}

static void await_frames(imu_driver_t *driver) {
    const uint32_t some_us = 5u * period_us(&driver->config);
    driver->state = IMU_WAITING;
    driver->sent = false;
    driver->bytes_seen = 0;
    driver->deadline_us = driver->now_us + FIRST_FRAME_MARGIN_US +
                          (some_us < FIRST_FRAME_MAX_US ? some_us : FIRST_FRAME_MAX_US);
}

static void advance(imu_driver_t *driver) {
    unsigned step = driver->step;
    if (step == STEP_RESUME) {
        await_frames(driver);
        return;
    }
    if (step == STEP_RESTART) {
        begin(driver);
        return;
    }
    do {
        step++;
    } while (!needed(driver, step));
    enter(driver, (step_t)step);
}

static void copy_name(char *name, const imu_text_t *body) {
    const imu_text_t text = imu_line_field(*body, 2);
    const size_t length = text.length < IMU_NAME_BYTES ? text.length : IMU_NAME_BYTES - 1u;
    memcpy(name, text.chars, length);
    name[length] = 0;
}

static bool is_vn100(const char *model) {
    return memcmp(model, "VN-100", 6) == 0 || memcmp(model, "VN100", 5) == 0;
}

static void found(imu_driver_t *driver, const imu_text_t *body) {
    copy_name(driver->model, body);
    driver->found_baud = driver->line_baud;
    if (!is_vn100(driver->model)) {
        conclude(driver, IMU_PROBLEM_NOT_A_VN100);
        return;
    }
    const uint8_t guess = driver->found_port != 0 ? driver->found_port : 2u;
    driver->port = driver->config.port != 0 ? driver->config.port : guess;
    driver->both_ports = false;
    driver->needs_save = false;
    driver->state = IMU_CONFIGURING;
    advance(driver);
}

/* What a write of register 35 keeps as it is: modes of one digit. */
static bool keep_vpe(imu_driver_t *driver, const imu_text_t *body) {
    for (unsigned i = 0; i < sizeof driver->vpe; i++) {
        const imu_text_t mode = imu_line_field(*body, i + 2u);
        if (mode.length != 1 || (uint8_t)(*mode.chars - '0') > 9) {
            return false;
        }
        driver->vpe[i] = (uint8_t)(*mode.chars - '0');
    }
    return true;
}

static void refuse(imu_driver_t *driver) {
    driver->error_code = 0;
    fail(driver, IMU_PROBLEM_REFUSED);
}

static void judge_values(imu_driver_t *driver, bool right) {
    const bool write = COMMANDS[driver->step][2] == 'W' && driver->step != STEP_SAVE;
    if (driver->phase == PHASE_LOOK && driver->step == STEP_MOUNT) {
        driver->needs_save = !right;
        advance(driver);
    } else if (driver->phase == PHASE_LOOK && !right) {
        go_to_phase(driver, PHASE_SEND);
    } else if (!right) {
        refuse(driver);
    } else if (driver->phase == PHASE_SEND && write) {
        if (driver->step == STEP_BAUD) {
            driver->target_baud = driver->config.baud;
        }
        go_to_phase(driver, PHASE_VERIFY);
    } else {
        advance(driver);
    }
}

static void take_reply(imu_driver_t *driver, const imu_text_t *body) {
    char text[IMU_COMMAND_MAX_BYTES];
    const imu_text_t want = {text, wanted(driver, text)};
    if (!answers(body, &want)) {
        return;
    }
    driver->replies++;
    driver->answered = true;
    if (driver->step == STEP_FIND) {
        found(driver, body);
        return;
    }
    if (driver->step == STEP_FIRMWARE) {
        copy_name(driver->firmware, body);
    }
    if (driver->step == STEP_HEADING && driver->phase == PHASE_LOOK) {
        if (!keep_vpe(driver, body)) {
            refuse(driver);
            return;
        }
        (void)wanted(driver, text); /* of the same length, with the modes that are kept */
    }
    judge_values(driver, same_values(driver, body, &want));
}

static imu_problem_t problem_of(unsigned code) {
    switch (code) {
    case ERROR_BAUD_TOO_LOW:
        return IMU_PROBLEM_BAUD_TOO_LOW;
    case ERROR_BUFFER_OVERFLOW:
    case ERROR_CHECKSUM:
    case ERROR_WATCHDOG:
    case ERROR_OUTPUT_OVERFLOW:
    case ERROR_TOO_MANY:
        return IMU_PROBLEM_NOISY;
    default:
        return IMU_PROBLEM_REFUSED;
    }
}

static void take_error(imu_driver_t *driver, unsigned code) {
    driver->errors++;
    driver->answered = true;
    driver->error_code = (uint8_t)code;
    /* While searching it complains of what stood in its buffer, too; the answer follows. */
    if (driver->sent && driver->step != STEP_FIND) {
        fail(driver, problem_of(code));
    }
}

/* Measurements are printed with their sign, replies begin with the number of a register. */
static bool is_measurement(imu_text_t body) {
    const imu_text_t first = imu_line_field(body, 1);
    return first.length != 0 && (*first.chars == '+' || *first.chars == '-');
}

void imu_driver_init(imu_driver_t *driver, const imu_driver_config_t *config, uint64_t now_us) {
    REQUIRE(imu_driver_config_valid(config));
    *driver =
        (imu_driver_t){.config = *config, .check = IMU_CHECK_XOR8, .now_us = (uint32_t)now_us};
    begin(driver);
}

void imu_driver_bytes(imu_driver_t *driver, uint32_t count) { driver->bytes_seen += count; }

void imu_driver_message(imu_driver_t *driver, const imu_message_t *message, uint64_t now_us) {
    driver->now_us = (uint32_t)now_us;
    driver->messages_seen++;
    driver->heard = true;
    if (message->kind != IMU_LINE) {
        return;
    }
    const imu_text_t body = imu_line_body(message);
    driver->check = imu_line_check(message);
    if (imu_line_is(body, "VNERR")) {
        take_error(driver, imu_line_error(body));
    } else if (driver->sent) {
        take_reply(driver, &body);
    } else if (driver->state >= IMU_WAITING && is_measurement(body)) {
        begin(driver); /* ASCII output is back: it has restarted */
    }
}

void imu_driver_frame(imu_driver_t *driver, bool restart, uint64_t now_us) {
    driver->messages_seen++;
    driver->heard = true;
    driver->now_us = (uint32_t)now_us;
    driver->last_frame_us = driver->now_us;
    if (driver->state == IMU_WAITING) {
        driver->state = IMU_STREAMING;
        driver->found_port = driver->port;
        driver->error_code = 0;
        driver->problem = driver->needs_save ? IMU_PROBLEM_NEEDS_SAVE : IMU_PROBLEM_NONE;
    } else if (driver->state == IMU_STREAMING && restart) {
        begin(driver);
    }
}

void imu_driver_save(imu_driver_t *driver) { driver->save_wanted = true; }

bool imu_driver_give_row(imu_driver_t *driver, unsigned row, const float element[3]) {
    REQUIRE(row < IMU_ROWS);
    for (unsigned i = 0; i < 3; i++) {
        if (!(element[i] >= -IMU_ROW_MAX && element[i] <= IMU_ROW_MAX)) {
            return false;
        }
    }
    for (unsigned i = 0; i < 3; i++) {
        const float millionths = element[i] * (float)MILLION;
        driver->row_millionths[row][i] = (int32_t)(millionths + (millionths < 0 ? -0.5f : 0.5f));
    }
    driver->rows_given |= (uint8_t)(1u << row);
    return true;
}

static void no_frame_came(imu_driver_t *driver) {
    if (frames_came(driver)) {
        search(driver); /* but damaged */
    } else if (!try_other_port(driver)) {
        conclude(driver, IMU_PROBLEM_WRONG_PORT);
    }
}

static void watch_stream(imu_driver_t *driver) {
    if (driver->now_us - driver->last_frame_us > imu_driver_patience_us(&driver->config)) {
        begin(driver);
    } else if (driver->save_wanted) {
        driver->save_wanted = false;
        state_problem(driver, IMU_PROBLEM_STARTING);
        driver->state = IMU_CONFIGURING;
        const bool rows = driver->rows_given == ROWS_ALL;
        driver->rows_given = 0;
        enter(driver, rows ? STEP_SAVE_ACCEL : driver->needs_save ? STEP_SAVE_MOUNT : STEP_SAVE);
    }
}

static void pass_time(imu_driver_t *driver) {
    if (driver->state != IMU_STREAMING && reached(driver, driver->verdict_us)) {
        state_problem(driver, verdict(driver));
    }
    if (driver->state == IMU_STREAMING) {
        watch_stream(driver);
    } else if (reached(driver, driver->deadline_us) && driver->state == IMU_WAITING) {
        no_frame_came(driver);
    } else if (reached(driver, driver->deadline_us) && driver->sent) {
        fail(driver, IMU_PROBLEM_NOISY);
    }
}

imu_action_t imu_driver_poll(imu_driver_t *driver, uint64_t now_us) {
    driver->now_us = (uint32_t)now_us;
    pass_time(driver);
    imu_action_t action = {.what = IMU_DO_NOTHING};
    if (driver->state >= IMU_WAITING || !reached(driver, driver->deadline_us)) {
        return action;
    }
    if (driver->line_baud != driver->target_baud) {
        driver->line_baud = driver->target_baud;
        driver->deadline_us = driver->now_us + SETTLE_US;
        action.what = IMU_DO_SET_BAUD;
        action.baud = driver->line_baud;
    } else {
        send(driver, &action);
    }
    return action;
}
