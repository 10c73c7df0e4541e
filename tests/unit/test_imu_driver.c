/* The driver against a sensor written from the manual: registers, checks, acceptance rule, two
 * ports, speeds, and what goes wrong with such a thing. Nothing here uses the code under test but
 * the driver and its reading of lines. */
#include "imu/driver.h"

#include "target.h"
#include "unity.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define STEP_US 500u
#define SECOND_US 1000000u
#define OUTBOX 16u
#define LOG_LINES 1024u
#define POLLS_MAX 8u

typedef struct {
    char text[160];
    uint64_t due_us;
    uint32_t baud;
} outgoing_t;

static struct {
    /* How it is wired and how it misbehaves. */
    uint8_t wired_port;
    bool fw3, dead, deaf, wedged, check16, errors_unsent, garbage_out, forgets_off, frames_damaged;
    uint32_t latency_us, damage_every, wakes_us;
    int refused_register, refused_code, stubborn_register;
    /* What it holds. */
    char reg[100][120], flash[100][120];
    uint32_t baud;
    bool paused, stale_input;
    uint64_t started_us, restart_us, next_frame_us, next_ascii_us;
    uint32_t bytes_out, saves, restarts;
    outgoing_t outbox[OUTBOX];
    size_t out_count;
} sensor;

static imu_driver_t driver;
static imu_driver_config_t config;
static uint64_t now_us;
static uint32_t our_baud;
static char log_lines[LOG_LINES][IMU_COMMAND_MAX_BYTES];
static size_t log_count;

/* Texts here are shorter than their room; if one is not, the test is wrong. */
static void keep(char *room, size_t size, const char *text) {
    const size_t length = strlen(text);
    TEST_ASSERT_TRUE(length < size);
    memcpy(room, text, length + 1u);
}

static uint32_t xor8(const char *text, size_t length) {
    uint32_t sum = 0;
    for (size_t i = 0; i < length; i++) {
        sum ^= (uint8_t)text[i];
    }
    return sum;
}

static uint32_t crc16(const char *text, size_t length) {
    uint32_t crc = 0;
    for (size_t i = 0; i < length; i++) {
        crc ^= (uint32_t)(uint8_t)text[i] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = ((crc & 0x8000u) != 0 ? crc << 1 ^ 0x1021u : crc << 1) & 0xFFFFu;
        }
    }
    return crc;
}

static void seal(char *line, size_t room, const char *body) {
    if (sensor.check16) {
        (void)snprintf(line, room, "$%s*%04X\r\n", body, (unsigned)crc16(body, strlen(body)));
    } else {
        (void)snprintf(line, room, "$%s*%02X\r\n", body, (unsigned)xor8(body, strlen(body)));
    }
}

static uint64_t line_us(size_t bytes, uint32_t baud) { return bytes * 10000000ull / baud; }

static void sensor_say(const char *body, uint64_t when_us) {
    if (sensor.out_count == OUTBOX) {
        return;
    }
    outgoing_t *out = &sensor.outbox[sensor.out_count++];
    seal(out->text, sizeof out->text, body);
    out->baud = sensor.baud;
    out->due_us = when_us + line_us(strlen(out->text), sensor.baud);
}

static void sensor_complain(unsigned code, uint64_t when_us) {
    char body[16];
    (void)snprintf(body, sizeof body, sensor.fw3 ? "VNERR,%02X" : "VNERR,%02u", code);
    if (!sensor.errors_unsent) {
        sensor_say(body, when_us);
    }
}

static void sensor_power_on(void) {
    memcpy(sensor.reg, sensor.flash, sizeof sensor.reg);
    sensor.baud = (uint32_t)strtoul(sensor.reg[5], NULL, 10);
    sensor.paused = false;
    sensor.wedged = false;
    sensor.started_us = now_us;
    sensor.next_frame_us = sensor.next_ascii_us = now_us + sensor.wakes_us + 1000;
    sensor.out_count = 0;
    sensor.restarts++;
}

static uint32_t ascii_rate(void) { return strcmp(sensor.reg[6], "14") == 0 ? 40 : 0; }

/* Frames per second of binary output |number| on |port|. */
static uint32_t binary_rate(int number, unsigned port) {
    unsigned mode = 0, divisor = 0;
    const int fields = sscanf(sensor.reg[number], "%u,%u", &mode, &divisor);
    const bool on = mode == 3 || mode == port;
    return fields == 2 && on && divisor != 0 ? 800 / divisor : 0;
}

static bool fits(void) {
    const unsigned port = sensor.wired_port;
    const uint32_t sum = 122 * ascii_rate() + 64 * (binary_rate(75, port) + binary_rate(76, port) +
                                                    binary_rate(77, port));
    return sum <= sensor.baud / 10;
}

static void sensor_write(int number, const char *values, const char *body, uint64_t when_us) {
    char before[120];
    keep(before, sizeof before, sensor.reg[number]);
    keep(sensor.reg[number], sizeof sensor.reg[number], values);
    if (number == sensor.refused_register) {
        sensor_complain((unsigned)sensor.refused_code, when_us);
    } else if (!fits()) {
        sensor_complain(12, when_us);
    } else {
        sensor_say(body, when_us);
        if (number != sensor.stubborn_register) {
            if (sensor.forgets_off && number >= 75 && number <= 77 &&
                strncmp(values, "0,", 2) == 0) {
                keep(sensor.reg[number], sizeof sensor.reg[number], "0,0,0");
            }
            if (number == 5) {
                sensor.baud = (uint32_t)strtoul(values, NULL, 10);
            }
            return;
        }
    }
    keep(sensor.reg[number], sizeof sensor.reg[number], before);
}

static void sensor_obey(const char *body, uint64_t when_us) {
    char reply[140];
    const int number = strlen(body) >= 8 ? atoi(body + 6) : 0;
    if (strncmp(body, "VNRRG,", 6) == 0) {
        (void)snprintf(reply, sizeof reply, "VNRRG,%02d,%s", number, sensor.reg[number]);
        sensor_say(reply, when_us);
    } else if (strncmp(body, "VNWRG,", 6) == 0 && strlen(body) > 9) {
        sensor_write(number, body + 9, body, when_us);
    } else if (strncmp(body, "VNASY,", 6) == 0) {
        sensor.paused = body[6] == '0';
        sensor_say(body, when_us);
    } else if (strcmp(body, "VNWNV") == 0) {
        memcpy(sensor.flash, sensor.reg, sizeof sensor.reg);
        sensor.saves++;
        sensor_say(body, when_us + SECOND_US / 2);
    } else if (strcmp(body, "VNRST") == 0) {
        sensor_say(body, when_us);
        sensor.restart_us = when_us + 10000;
    } else {
        sensor_complain(4, when_us);
    }
}

static bool sensor_alive(void) {
    return !sensor.dead && !sensor.wedged && now_us >= sensor.started_us + sensor.wakes_us;
}

/* One line as it comes in, "$...\r\n". */
static void sensor_hear_line(const char *line, uint64_t when_us) {
    char body[120];
    const char *star = strchr(line, '*');
    const size_t length = star == NULL ? 0 : (size_t)(star - line) - 1u;
    if (star == NULL || length >= sizeof body || sensor.stale_input) {
        sensor.stale_input = false;
        sensor_complain(3, when_us);
        return;
    }
    memcpy(body, line + 1, length);
    body[length] = 0;
    const size_t digits = strcspn(star + 1, "\r");
    const uint32_t given = (uint32_t)strtoul(star + 1, NULL, 16);
    const uint32_t right = sensor.check16 ? crc16(body, length) : xor8(body, length);
    if (digits != (sensor.check16 ? 4u : 2u) || given != right) {
        sensor_complain(3, when_us);
        return;
    }
    sensor_obey(body, when_us);
}

static void sensor_hear(const char *bytes, size_t length) {
    if (!sensor_alive() || sensor.deaf) {
        return;
    }
    if (our_baud != sensor.baud) {
        sensor.stale_input = true;
        return;
    }
    char text[200];
    TEST_ASSERT_TRUE(length < sizeof text);
    memcpy(text, bytes, length);
    text[length] = 0;
    const uint64_t when_us = now_us + line_us(length, our_baud) + sensor.latency_us;
    char *line = text;
    if (strncmp(text, "\r\n", 2) == 0) {
        if (sensor.stale_input) {
            sensor_complain(3, when_us);
        }
        sensor.stale_input = false;
        line += 2;
    }
    TEST_ASSERT_EQUAL_STRING("\r\n", line + strlen(line) - 2);
    sensor_hear_line(line, when_us);
}

/* Counts the bytes on their way to us; true when one of them is to be damaged. */
static bool damaged(size_t bytes) {
    const uint32_t before = sensor.bytes_out;
    sensor.bytes_out += (uint32_t)bytes;
    return sensor.damage_every != 0 &&
           before / sensor.damage_every != sensor.bytes_out / sensor.damage_every;
}

static void deliver(const char *text, uint32_t baud) {
    imu_driver_bytes(&driver, (uint32_t)strlen(text));
    if (damaged(strlen(text)) || baud != our_baud || sensor.garbage_out) {
        return;
    }
    const imu_message_t message = {IMU_LINE, (uint16_t)strlen(text), (const uint8_t *)text};
    imu_driver_message(&driver, &message, now_us);
}

static void deliver_replies(void) {
    for (size_t i = 0; i < sensor.out_count;) {
        if (sensor.outbox[i].due_us > now_us) {
            i++;
            continue;
        }
        const outgoing_t out = sensor.outbox[i];
        sensor.out_count--;
        memmove(&sensor.outbox[i], &sensor.outbox[i + 1],
                (sensor.out_count - i) * sizeof sensor.outbox[0]);
        deliver(out.text, out.baud);
    }
}

static void deliver_ascii(void) {
    if (ascii_rate() != 0 && now_us >= sensor.next_ascii_us) {
        char line[160];
        seal(line, sizeof line,
             "VNYMR,+100.949,-011.161,-000.040,+01.0640,-00.0000,+01.5000,"
             "-01.906,-00.011,-09.614,+00.000000,+00.000000,+00.000000");
        sensor.next_ascii_us = now_us + SECOND_US / 40;
        deliver(line, sensor.baud);
    }
}

static void deliver_frames(bool *restarted) {
    const uint32_t rate = binary_rate(75, sensor.wired_port);
    if (rate == 0 || now_us < sensor.next_frame_us) {
        return;
    }
    sensor.next_frame_us += SECOND_US / rate;
    if (sensor.next_frame_us < now_us) {
        sensor.next_frame_us = now_us;
    }
    imu_driver_bytes(&driver, 64);
    if (!damaged(64) && !sensor.frames_damaged && our_baud == sensor.baud && !sensor.garbage_out) {
        imu_driver_frame(&driver, *restarted, now_us);
        *restarted = false;
    }
}

static void note(const imu_action_t *action) {
    const char *dollar = memchr(action->bytes, '$', action->length);
    TEST_ASSERT_NOT_NULL(dollar);
    TEST_ASSERT_TRUE(log_count < LOG_LINES);
    const size_t length = strcspn(dollar + 1, "*");
    TEST_ASSERT_TRUE(length < sizeof log_lines[0]);
    memcpy(log_lines[log_count], dollar + 1, length);
    log_lines[log_count++][length] = 0;
}

static void poll_driver(void) {
    for (unsigned polls = 0;; polls++) {
        TEST_ASSERT_TRUE_MESSAGE(polls < POLLS_MAX, "it never comes to rest");
        const imu_action_t action = imu_driver_poll(&driver, now_us);
        if (action.what == IMU_DO_NOTHING) {
            return;
        }
        if (action.what == IMU_DO_SET_BAUD) {
            our_baud = action.baud;
            continue;
        }
        note(&action);
        sensor_hear(action.bytes, action.length);
    }
}

static bool restart_unseen;

static void run_us(uint64_t time_us) {
    const uint64_t end_us = now_us + time_us;
    while (now_us < end_us) {
        now_us += STEP_US;
        if (sensor.restart_us != 0 && now_us >= sensor.restart_us) {
            sensor.restart_us = 0;
            sensor.wakes_us = SECOND_US;
            sensor_power_on();
        }
        if (sensor_alive()) {
            deliver_replies();
            if (!sensor.paused) {
                deliver_ascii();
                deliver_frames(&restart_unseen);
            }
        }
        poll_driver();
    }
}

static void set_flash(int number, const char *values) {
    keep(sensor.flash[number], sizeof sensor.flash[number], values);
}

void setUp(void) {
    memset(&sensor, 0, sizeof sensor);
    sensor.wired_port = 2;
    sensor.latency_us = 2000;
    set_flash(1, "VN-100T-CR");
    set_flash(4, "2.0.0.0");
    set_flash(5, "115200");
    set_flash(6, "14");
    set_flash(26, "+1.000000,+0.000000,+0.000000,+0.000000,+1.000000,+0.000000,+0.000000,+0.000000,"
                  "+1");
    set_flash(35, "1,1,1,1");
    set_flash(75, "0,1,01,0001");
    set_flash(76, "0,1,01,0001");
    set_flash(77, "0,1,01,0001");
    set_flash(85, "0,4,4,4,0,0,3,3,3,0");
    config = (imu_driver_config_t){.baud = 115200, .rate_hz = 100, .heading = -1};
    now_us = 123456789;
    our_baud = 115200;
    log_count = 0;
    restart_unseen = false;
    sensor_power_on();
}

void tearDown(void) {}

static void start(void) {
    sensor_power_on();
    imu_driver_init(&driver, &config, now_us);
}

/* Returns how long it took to the stream or to a problem; fails when it took too long. */
static uint64_t run_to_verdict(void) {
    const uint64_t begin_us = now_us;
    while (driver.problem == IMU_PROBLEM_STARTING) {
        run_us(STEP_US);
        TEST_ASSERT_TRUE(now_us - begin_us <= IMU_DRIVER_VERDICT_US);
    }
    return now_us - begin_us;
}

static void assert_streams(void) {
    (void)run_to_verdict();
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_NONE, driver.problem);
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
    TEST_ASSERT_EQUAL_STRING("0", sensor.reg[6]);
    char output[40];
    (void)snprintf(output, sizeof output, "%u,%u,11,0129,0040", sensor.wired_port,
                   800u / config.rate_hz);
    TEST_ASSERT_EQUAL_STRING(output, sensor.reg[75]);
    TEST_ASSERT_EQUAL_UINT32(config.baud, sensor.baud);
    TEST_ASSERT_EQUAL_UINT32(config.baud, our_baud);
    TEST_ASSERT_EQUAL_UINT32(sensor.wired_port, driver.found_port);
    TEST_ASSERT_FALSE(sensor.paused);
}

static void assert_problem(imu_problem_t problem) {
    (void)run_to_verdict();
    TEST_ASSERT_EQUAL_INT(problem, driver.problem);
    TEST_ASSERT_NOT_EQUAL(IMU_STREAMING, driver.state);
}

/* The place of the first command that begins like this, LOG_LINES when there is none. */
static size_t place_of(const char *begin) {
    for (size_t i = 0; i < log_count; i++) {
        if (strncmp(log_lines[i], begin, strlen(begin)) == 0) {
            return i;
        }
    }
    return LOG_LINES;
}

static void assert_sent(const char *command) {
    const size_t place = place_of(command);
    TEST_ASSERT_TRUE_MESSAGE(place != LOG_LINES, command);
    TEST_ASSERT_EQUAL_STRING(command, log_lines[place]);
}

static void assert_never_sent(const char *begin) {
    TEST_ASSERT_EQUAL_size_t_MESSAGE(LOG_LINES, place_of(begin), begin);
}

static void a_sensor_from_the_factory_is_set_up(void) {
    start();
    assert_streams();
    TEST_ASSERT_EQUAL_STRING("VN-100T-CR", driver.model);
    TEST_ASSERT_EQUAL_STRING("2.0.0.0", driver.firmware);
    TEST_ASSERT_EQUAL_UINT32(115200, driver.found_baud);
    TEST_ASSERT_EQUAL_STRING("0,8,8,4,0,0,3,3,3,0", sensor.reg[85]);
    TEST_ASSERT_EQUAL_UINT32(0, driver.errors);
    TEST_ASSERT_EQUAL_UINT32(0, driver.retries);
    TEST_ASSERT_EQUAL_UINT32(log_count, driver.replies);
}

/* The commands are those of vectors checked by hand (their checks by the sensor above). */
static void commands_come_in_an_order_the_sensor_can_accept(void) {
    static const char *const EXPECTED[] = {
        "VNRRG,01", "VNASY,0",
        "VNRRG,04", "VNWRG,06,0",
        "VNRRG,06", "VNWRG,75,0,8,11,0129,0040",
        "VNRRG,75", "VNWRG,76,0,8,11,0129,0040",
        "VNRRG,76", "VNWRG,77,0,8,11,0129,0040",
        "VNRRG,77", "VNWRG,85,0,8,8,4,0,0,3,3,3,0",
        "VNRRG,85", "VNWRG,75,2,8,11,0129,0040",
        "VNRRG,75", "VNASY,1",
    };
    start();
    assert_streams();
    TEST_ASSERT_EQUAL_size_t(sizeof EXPECTED / sizeof EXPECTED[0], log_count);
    for (size_t i = 0; i < log_count; i++) {
        TEST_ASSERT_EQUAL_STRING(EXPECTED[i], log_lines[i]);
    }
}

static void it_is_found_at_every_speed(void) {
    static const char *const BAUDS[] = {"9600",   "19200",  "38400",  "57600", "115200",
                                        "128000", "230400", "460800", "921600"};
    for (size_t i = 0; i < sizeof BAUDS / sizeof BAUDS[0]; i++) {
        setUp();
        set_flash(5, BAUDS[i]);
        if (i < 3) {
            set_flash(6, "0");
        }
        start();
        assert_streams();
        TEST_ASSERT_EQUAL_UINT32(strtoul(BAUDS[i], NULL, 10), driver.found_baud);
        TEST_ASSERT_EQUAL_STRING("115200", sensor.reg[5]);
    }
}

static void a_faster_line_carries_more_frames(void) {
    config.baud = 460800;
    config.rate_hz = 400;
    start();
    assert_streams();
    assert_sent("VNWRG,05,460800");
    assert_sent("VNRRG,05");
    TEST_ASSERT_TRUE(place_of("VNWRG,05") < place_of("VNWRG,75,2"));
    TEST_ASSERT_EQUAL_STRING("0,2,2,4,0,0,3,3,3,0", sensor.reg[85]);
}

static void a_slower_line_needs_the_other_outputs_off_first(void) {
    set_flash(5, "921600");
    set_flash(76, "2,1,11,0129,0040");
    start();
    assert_streams();
    TEST_ASSERT_EQUAL_UINT32(1, driver.errors); /* about what we sent at another speed */
}

static void the_port_is_found_out(void) {
    sensor.wired_port = 1;
    start();
    assert_streams();
    assert_sent("VNWRG,75,2,8,11,0129,0040");
    assert_sent("VNWRG,75,1,8,11,0129,0040");
}

static void a_found_port_is_tried_first_the_next_time(void) {
    sensor.wired_port = 1;
    start();
    assert_streams();
    sensor_power_on();
    log_count = 0;
    run_us(2 * SECOND_US);
    assert_streams();
    assert_sent("VNWRG,75,1,8,11,0129,0040");
    assert_never_sent("VNWRG,75,2");
}

static void a_wrong_port_is_told(void) {
    config.port = 2;
    sensor.wired_port = 1;
    start();
    assert_problem(IMU_PROBLEM_WRONG_PORT);
    TEST_ASSERT_EQUAL_UINT32(0, driver.found_port);
}

static void a_given_port_is_used(void) {
    config.port = 1;
    sensor.wired_port = 1;
    start();
    assert_streams();
    assert_never_sent("VNWRG,75,2");
}

/* Neither port is ours: says so after a try of each. */
static void two_wrong_ports_are_told(void) {
    sensor.wired_port = 4;
    start();
    TEST_ASSERT_TRUE(run_to_verdict() < SECOND_US);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_WRONG_PORT, driver.problem);

    setUp();
    sensor.wired_port = 4;
    sensor.latency_us = 70000;
    set_flash(5, "128000");
    config.rate_hz = 1;
    start();
    assert_problem(IMU_PROBLEM_WRONG_PORT);
}

static void damaged_frames_are_no_wrong_port(void) {
    config.port = 2;
    sensor.frames_damaged = true;
    start();
    assert_problem(IMU_PROBLEM_NOISY);
}

static void frames_of_one_a_second_are_waited_for(void) {
    config.rate_hz = 1;
    start();
    assert_streams();
    const uint32_t frames = driver.messages_seen;
    run_us(10 * SECOND_US);
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
    TEST_ASSERT_UINT32_WITHIN(1, frames + 10, driver.messages_seen);
}

static void both_notations_of_errors_are_read(void) {
    for (int fw3 = 0; fw3 < 2; fw3++) {
        setUp();
        sensor.fw3 = fw3 != 0;
        set_flash(4, fw3 != 0 ? "3.1.0.0" : "2.0.0.0");
        sensor.refused_register = 75;
        sensor.refused_code = 12;
        start();
        assert_problem(IMU_PROBLEM_BAUD_TOO_LOW);
        TEST_ASSERT_EQUAL_UINT8(12, driver.error_code);
        TEST_ASSERT_EQUAL_STRING(fw3 != 0 ? "3.1.0.0" : "2.0.0.0", driver.firmware);
    }
}

static void a_refused_setting_is_told_with_its_code(void) {
    static const int REGISTERS[] = {6, 75, 76, 77, 85};
    for (size_t i = 0; i < sizeof REGISTERS / sizeof REGISTERS[0]; i++) {
        setUp();
        sensor.refused_register = REGISTERS[i];
        sensor.refused_code = 8;
        start();
        assert_problem(IMU_PROBLEM_REFUSED);
        TEST_ASSERT_EQUAL_UINT8(8, driver.error_code);
        run_us(10 * SECOND_US);
        TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_REFUSED, driver.problem);
        TEST_ASSERT_TRUE_MESSAGE(log_count < 300, "it floods the line");
        sensor.refused_register = 0;
        run_us(3 * SECOND_US);
        TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_NONE, driver.problem);
        TEST_ASSERT_EQUAL_UINT8(0, driver.error_code);
    }
}

static void complaints_of_damage_are_no_refusal(void) {
    static const int CODES[] = {2, 3, 10, 11, 255};
    for (size_t i = 0; i < sizeof CODES / sizeof CODES[0]; i++) {
        setUp();
        sensor.refused_register = 6;
        sensor.refused_code = CODES[i];
        start();
        assert_problem(IMU_PROBLEM_NOISY);
    }
}

static void an_output_that_is_off_may_forget_its_layout(void) {
    sensor.forgets_off = true;
    start();
    assert_streams();
    TEST_ASSERT_EQUAL_UINT32(0, driver.retries);
}

static void what_is_echoed_but_not_kept_is_noticed(void) {
    static const int REGISTERS[] = {6, 75, 85};
    for (size_t i = 0; i < sizeof REGISTERS / sizeof REGISTERS[0]; i++) {
        setUp();
        sensor.stubborn_register = REGISTERS[i];
        sensor.stale_input = true; /* makes for an error before that must not be blamed */
        start();
        assert_problem(IMU_PROBLEM_REFUSED);
        TEST_ASSERT_EQUAL_UINT8(0, driver.error_code);
    }
}

static void a_baud_rate_that_is_not_taken_is_no_stream(void) {
    config.baud = 230400;
    sensor.stubborn_register = 5;
    start();
    assert_problem(IMU_PROBLEM_NOISY);
}

static void commands_use_the_check_the_sensor_uses(void) {
    for (int unsent = 0; unsent < 2; unsent++) {
        setUp();
        sensor.check16 = true;
        sensor.errors_unsent = unsent != 0;
        set_flash(6, "0");
        start();
        assert_streams();
    }
}

static void rests_in_the_sensors_buffer_do_no_harm(void) {
    sensor.stale_input = true;
    start();
    assert_streams();
    TEST_ASSERT_EQUAL_UINT32(1, driver.errors);
}

static void a_slow_line_is_given_its_time(void) {
    config.baud = 9600;
    config.rate_hz = 10;
    set_flash(5, "9600");
    set_flash(6, "0");
    sensor.latency_us = 40000;
    start();
    assert_streams();
    TEST_ASSERT_EQUAL_UINT32(0, driver.retries);
}

static void a_late_reply_about_another_register_is_no_answer(void) {
    sensor.latency_us = 20000;
    start();
    run_us(6000);
    TEST_ASSERT_EQUAL_size_t(1, log_count);
    sensor_say("VNRRG,04,2.0.0.0", now_us);
    assert_streams();
    TEST_ASSERT_EQUAL_STRING("VN-100T-CR", driver.model);
    TEST_ASSERT_EQUAL_UINT32(0, driver.retries);
}

static void late_echoes_are_recognised(void) {
    static const uint32_t LATENCIES_US[] = {20000, 60000, 95000, 130000, 150000};
    for (size_t i = 0; i < sizeof LATENCIES_US / sizeof LATENCIES_US[0]; i++) {
        setUp();
        sensor.latency_us = LATENCIES_US[i];
        start();
        assert_streams();
    }
}

static void noise_ends_in_a_stream_or_is_told(void) {
    unsigned streams = 0, noisy = 0;
    for (uint32_t every = 40; every < 2000; every += 61) {
        setUp();
        sensor.damage_every = every;
        start();
        (void)run_to_verdict();
        TEST_ASSERT_TRUE(driver.problem == IMU_PROBLEM_NONE || driver.problem == IMU_PROBLEM_NOISY);
        streams += driver.problem == IMU_PROBLEM_NONE;
        noisy += driver.problem == IMU_PROBLEM_NOISY;
    }
    TEST_ASSERT_TRUE(streams >= 28 && noisy >= 1);
}

static void nothing_at_all_is_silence(void) {
    sensor.dead = true;
    start();
    assert_problem(IMU_PROBLEM_SILENT);
    run_us(20 * SECOND_US);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_SILENT, driver.problem);
    sensor.dead = false;
    run_us(5 * SECOND_US);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_NONE, driver.problem);
}

static void garbage_at_all_speeds_is_unreadable(void) {
    sensor.garbage_out = true;
    start();
    assert_problem(IMU_PROBLEM_UNREADABLE);
    run_us(20 * SECOND_US);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_UNREADABLE, driver.problem);
}

static void a_sensor_that_does_not_listen_is_told(void) {
    for (int binary = 0; binary < 2; binary++) {
        setUp();
        sensor.deaf = true;
        if (binary != 0) {
            set_flash(6, "0");
            set_flash(75, "3,8,11,0129,0040");
        }
        start();
        assert_problem(IMU_PROBLEM_NO_REPLY);
    }
}

static void another_layout_counts_as_a_message(void) {
    sensor.dead = true;
    start();
    const uint8_t frame[26] = {0xFA};
    const imu_message_t message = {IMU_BINARY, sizeof frame, frame};
    for (int i = 0; i < 40; i++) {
        run_us(100000);
        imu_driver_bytes(&driver, sizeof frame);
        imu_driver_message(&driver, &message, now_us);
    }
    assert_problem(IMU_PROBLEM_NO_REPLY);
}

static void another_model_is_told(void) {
    static const char *const MODELS[] = {"VN-200T-CR", "VN-10", "XSENS", "", "vn-100"};
    for (size_t i = 0; i < sizeof MODELS / sizeof MODELS[0]; i++) {
        setUp();
        set_flash(1, MODELS[i]);
        start();
        assert_problem(IMU_PROBLEM_NOT_A_VN100);
        TEST_ASSERT_EQUAL_STRING(MODELS[i], driver.model);
        assert_never_sent("VNWRG");
    }
}

static void all_makes_of_the_model_will_do(void) {
    static const char *const MODELS[] = {"VN-100S-CR", "VN100", "VN-100",
                                         "VN-100 with a name that is too long"};
    for (size_t i = 0; i < sizeof MODELS / sizeof MODELS[0]; i++) {
        setUp();
        set_flash(1, MODELS[i]);
        start();
        assert_streams();
        TEST_ASSERT_EQUAL_STRING_LEN(MODELS[i], driver.model, IMU_NAME_BYTES - 1u);
        TEST_ASSERT_TRUE(strlen(driver.model) < IMU_NAME_BYTES);
    }
}

static void a_sensor_that_wakes_late_is_still_found(void) {
    sensor.wakes_us = 2 * SECOND_US;
    start();
    assert_streams();
}

static void a_restart_is_noticed_by_its_ascii_lines(void) {
    start();
    assert_streams();
    run_us(3 * SECOND_US);
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
    sensor_power_on();
    run_us(100000);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_STARTING, driver.problem);
    assert_streams();
}

static void a_restart_is_noticed_by_the_sensors_clock(void) {
    set_flash(6, "0");
    set_flash(75, "2,8,11,0129,0040");
    start();
    assert_streams();
    sensor_power_on();
    restart_unseen = true;
    run_us(20000);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_STARTING, driver.problem);
    assert_streams();
}

static void a_restart_at_another_speed_is_noticed_by_silence(void) {
    config.baud = 460800;
    start();
    assert_streams();
    sensor_power_on();
    run_us(600000);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_STARTING, driver.problem);
    assert_streams();
}

static void a_wedged_sensor_is_silent_until_it_is_switched(void) {
    start();
    assert_streams();
    sensor.wedged = true;
    run_us(450000);
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
    run_us(100000);
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_STARTING, driver.problem);
    assert_problem(IMU_PROBLEM_SILENT);
    sensor_power_on();
    run_us(5 * SECOND_US);
    assert_streams();
}

static void heading_mode_is_changed_and_nothing_else_of_it(void) {
    set_flash(35, "1,1,0,1");
    config.heading = 0;
    start();
    assert_streams();
    assert_sent("VNWRG,35,1,0,0,1");
    TEST_ASSERT_EQUAL_STRING("1,0,0,1", sensor.reg[35]);
}

static void heading_mode_is_left_alone_when_right_or_not_asked_for(void) {
    config.heading = 1;
    start();
    assert_streams();
    assert_sent("VNRRG,35");
    assert_never_sent("VNWRG,35");

    setUp();
    set_flash(35, "nonsense");
    start();
    assert_streams();
    assert_never_sent("VNRRG,35");
}

static void a_heading_register_that_makes_no_sense_is_not_written(void) {
    static const char *const VALUES[] = {"nonsense", "1,1,1", "1,,1,1", "1,999,1,1", ""};
    for (size_t i = 0; i < sizeof VALUES / sizeof VALUES[0]; i++) {
        setUp();
        set_flash(35, VALUES[i]);
        config.heading = 2;
        start();
        assert_problem(IMU_PROBLEM_REFUSED);
        assert_never_sent("VNWRG,35");
    }
}

static void another_mounting_needs_saving(void) {
    config.mount = 3;
    start();
    (void)run_to_verdict();
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_NEEDS_SAVE, driver.problem);
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
    assert_never_sent("VNWRG,26");
    assert_never_sent("VNWNV");

    log_count = 0;
    imu_driver_save(&driver);
    run_us(STEP_US);
    assert_streams();
    assert_sent("VNWRG,26,-1,0,0,0,-1,0,0,0,1");
    TEST_ASSERT_TRUE(place_of("VNWRG,26") < place_of("VNWNV"));
    TEST_ASSERT_TRUE(place_of("VNWNV") < place_of("VNRST"));
    TEST_ASSERT_EQUAL_STRING("-1,0,0,0,-1,0,0,0,1", sensor.flash[26]);
    TEST_ASSERT_EQUAL_UINT32(1, sensor.saves);
}

static void the_mounting_it_has_needs_nothing(void) {
    config.mount = 1;
    start();
    assert_streams();
    assert_sent("VNRRG,26");
    assert_never_sent("VNWRG,26");
}

/* Rows of a rotation are of length one, normal to each other and right-handed. */
static void mountings_are_rotations(void) {
    for (uint8_t mount = 1; mount <= 5; mount++) {
        setUp();
        set_flash(26, "9,0,0,0,9,0,0,0,9");
        config.mount = mount;
        start();
        (void)run_to_verdict();
        imu_driver_save(&driver);
        run_us(SECOND_US);
        int c[9];
        TEST_ASSERT_EQUAL_INT(9, sscanf(sensor.flash[26], "%d,%d,%d,%d,%d,%d,%d,%d,%d", &c[0],
                                        &c[1], &c[2], &c[3], &c[4], &c[5], &c[6], &c[7], &c[8]));
        TEST_ASSERT_EQUAL_INT(1, c[0] * c[0] + c[1] * c[1] + c[2] * c[2]);
        TEST_ASSERT_EQUAL_INT(1, c[3] * c[3] + c[4] * c[4] + c[5] * c[5]);
        TEST_ASSERT_EQUAL_INT(0, c[0] * c[3] + c[1] * c[4] + c[2] * c[5]);
        TEST_ASSERT_EQUAL_INT(c[6], c[1] * c[5] - c[2] * c[4]);
        TEST_ASSERT_EQUAL_INT(c[7], c[2] * c[3] - c[0] * c[5]);
        TEST_ASSERT_EQUAL_INT(c[8], c[0] * c[4] - c[1] * c[3]);
        /* Where the sensor's x axis points in the fish: ahead, ahead, back, right, left. */
        static const int X_TO[][2] = {{1, 0}, {1, 0}, {-1, 0}, {0, 1}, {0, -1}};
        TEST_ASSERT_EQUAL_INT(X_TO[mount - 1][0], c[0]);
        TEST_ASSERT_EQUAL_INT(X_TO[mount - 1][1], c[3]);
        TEST_ASSERT_EQUAL_INT(mount == 2 ? -1 : 1, c[8]);
    }
}

static void saving_happens_once_and_only_when_asked(void) {
    start();
    assert_streams();
    assert_never_sent("VNWNV");
    assert_never_sent("VNRST");
    imu_driver_save(&driver);
    run_us(STEP_US);
    assert_streams();
    run_us(10 * SECOND_US);
    TEST_ASSERT_EQUAL_UINT32(1, sensor.saves);
    assert_never_sent("VNWRG,26");
    TEST_ASSERT_EQUAL_STRING("2,8,11,0129,0040", sensor.flash[75]);
}

static void give_rows(unsigned count) {
    static const float ROWS[IMU_ROWS][3] = {{1, 0, 0},          {0, 1, 0},
                                            {0, 0, 1},          {1.000123f, -0.000512f, 0.25f},
                                            {-1.5f, 0.999f, 0}, {0, 0, 2}};
    for (unsigned row = 0; row < count; row++) {
        TEST_ASSERT_TRUE(imu_driver_give_row(&driver, row, ROWS[row]));
    }
}

static void a_calibration_is_written_when_it_is_whole(void) {
    start();
    assert_streams();
    give_rows(IMU_ROWS - 1u);
    imu_driver_save(&driver);
    run_us(10 * SECOND_US);
    assert_never_sent("VNWRG,84");
    TEST_ASSERT_EQUAL_UINT32(1, sensor.saves);

    log_count = 0;
    give_rows(IMU_ROWS);
    imu_driver_save(&driver);
    run_us(STEP_US);
    assert_streams();
    assert_sent("VNWRG,25,1.000000,0.000000,0.000000,0.000000,1.000000,0.000000,0.000000,0.000000,"
                "1.000000,0,0,0");
    assert_sent("VNWRG,84,1.000123,-0.000512,0.250000,-1.500000,0.999000,0.000000,0.000000,"
                "0.000000,2.000000,0,0,0");
    TEST_ASSERT_TRUE(place_of("VNWRG,84") < place_of("VNWNV"));
    TEST_ASSERT_EQUAL_UINT32(2, sensor.saves);

    imu_driver_save(&driver); /* once only */
    log_count = 0;
    run_us(10 * SECOND_US);
    assert_never_sent("VNWRG,84");
}

static void rows_that_make_no_sense_are_refused(void) {
    const float bad[][3] = {{2.1f, 0, 0}, {0, -2.1f, 0}, {0, 0, NAN}, {INFINITY, 0, 0}};
    start();
    assert_streams();
    give_rows(IMU_ROWS - 1u);
    for (unsigned i = 0; i < 4; i++) {
        TEST_ASSERT_FALSE(imu_driver_give_row(&driver, IMU_ROWS - 1u, bad[i]));
    }
    imu_driver_save(&driver);
    run_us(10 * SECOND_US);
    assert_never_sent("VNWRG,84");
}

static void a_save_waits_for_the_stream(void) {
    sensor.dead = true;
    start();
    imu_driver_save(&driver);
    run_us(10 * SECOND_US);
    assert_never_sent("VNWNV");
    sensor.dead = false;
    run_us(12 * SECOND_US);
    TEST_ASSERT_EQUAL_UINT32(1, sensor.saves);
    assert_streams();
}

static void lines_that_nobody_asked_for_change_nothing(void) {
    static const char *const BODIES[] = {
        "VNRRG,75,0,0,0", "VNWRG,06,14", "VNERR,03", "VNERR",
        "VNERR,99",       "VNASY,0",     "VNRRG",    "VNWRG,,,,",
    };
    start();
    assert_streams();
    for (size_t i = 0; i < sizeof BODIES / sizeof BODIES[0]; i++) {
        sensor_say(BODIES[i], now_us);
        run_us(50000);
        TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
    }
    TEST_ASSERT_EQUAL_UINT32(3, driver.errors);
}

/* Replies that fit no command, or fit with wrong values, between the right ones. */
static void nonsense_in_between_does_not_keep_it_from_the_stream(void) {
    static const char *const BODIES[] = {"VNRRG,04,9.9", "VNRRG,75,3,1", "VNYMR,+1,+2",
                                         "VNASY",        "VN",           "VNWRG,06,0,T12,S0000",
                                         "VNRRG,26,1"};
    start();
    for (unsigned i = 0; driver.state != IMU_STREAMING && i < 400; i++) {
        sensor_say(BODIES[i % (sizeof BODIES / sizeof BODIES[0])], now_us);
        run_us(10000);
    }
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
}

static void suffix_fields_are_tolerated(void) {
    set_flash(6, "14,2");
    start();
    keep(sensor.reg[35], sizeof sensor.reg[35], "1,1,1,1,T1162704,S0000");
    config.heading = 1;
    imu_driver_init(&driver, &config, now_us);
    assert_streams();
    assert_never_sent("VNWRG,35");
}

static void configurations_are_checked(void) {
    const imu_driver_config_t good = {.baud = 115200, .rate_hz = 100, .heading = -1};
    TEST_ASSERT_TRUE(imu_driver_config_valid(&good));
    static const struct {
        uint32_t baud;
        uint16_t rate_hz;
        bool valid;
    } LINES[] = {{115200, 160, true},   {115200, 200, false}, {230400, 200, true},
                 {460800, 400, true},   {460800, 800, false}, {921600, 800, true},
                 {9600, 10, true},      {9600, 16, false},    {115200, 0, false},
                 {115200, 3, false},    {115200, 1, true},    {921600, 801, false},
                 {921600, 1600, false}, {115201, 100, false}, {0, 1, false},
                 {128000, 200, true},   {4000000, 100, false}};
    for (size_t i = 0; i < sizeof LINES / sizeof LINES[0]; i++) {
        imu_driver_config_t c = good;
        c.baud = LINES[i].baud;
        c.rate_hz = LINES[i].rate_hz;
        TEST_ASSERT_EQUAL_INT(LINES[i].valid, imu_driver_config_valid(&c));
    }
    for (int value = -5; value < 10; value++) {
        imu_driver_config_t port = good, heading = good, mount = good;
        port.port = (uint8_t)value;
        heading.heading = (int8_t)value;
        mount.mount = (uint8_t)value;
        TEST_ASSERT_EQUAL_INT(value >= 0 && value <= 2, imu_driver_config_valid(&port));
        TEST_ASSERT_EQUAL_INT(value >= -1 && value <= 2, imu_driver_config_valid(&heading));
        TEST_ASSERT_EQUAL_INT(value >= 0 && value <= 5, imu_driver_config_valid(&mount));
    }
}

static void every_problem_has_words(void) {
#define IMU_PROBLEM(name, number, meaning, remedy)                                                 \
    TEST_ASSERT_EQUAL_STRING(meaning, imu_problem_meaning(IMU_PROBLEM_##name));                    \
    TEST_ASSERT_TRUE((number) == 0 || sizeof(remedy) > 10);
#include "imu/problems.def"
#undef IMU_PROBLEM
}

/* Whatever faults come together: a verdict in time, and no flood of commands. */
static void any_mixture_of_faults_ends_in_a_verdict(void) {
    uint32_t random = 4711;
    for (int run = 0; run < TIMES(60, 12); run++) {
        setUp();
        uint32_t draw[8];
        for (size_t i = 0; i < 8; i++) {
            random = random * 1664525u + 1013904223u;
            draw[i] = random >> 16;
        }
        static const char *const BAUDS[] = {"57600", "115200", "128000", "460800", "921600"};
        set_flash(5, BAUDS[draw[0] % 5]);
        sensor.wired_port = (uint8_t)(1 + draw[1] % 2);
        config.port = (uint8_t)(draw[1] / 2 % 3);
        sensor.damage_every = draw[2] % 2 == 0 ? 0 : 50 + draw[2] % 1000;
        sensor.latency_us = draw[3] % 4 == 0 ? draw[3] * 3 : 3000;
        sensor.wakes_us = draw[4] % 2 == 0 ? 0 : draw[4] * 60;
        sensor.check16 = draw[5] % 4 == 0;
        sensor.fw3 = draw[5] / 4 % 2 == 0;
        config.baud = draw[6] % 2 == 0 ? 115200 : 460800;
        config.mount = (uint8_t)(draw[6] / 2 % 6);
        config.heading = (int8_t)(draw[7] % 4 - 1);
        start();
        (void)run_to_verdict();
        sensor.damage_every = 0;
        sensor.latency_us = 2000;
        if (config.port != 0) {
            sensor.wired_port = config.port;
        }
        run_us(12 * SECOND_US);
        TEST_ASSERT_EQUAL_INT(IMU_STREAMING, driver.state);
        TEST_ASSERT_TRUE(log_count < 300);
    }
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(a_sensor_from_the_factory_is_set_up);
    RUN_TEST(commands_come_in_an_order_the_sensor_can_accept);
    RUN_TEST(it_is_found_at_every_speed);
    RUN_TEST(a_faster_line_carries_more_frames);
    RUN_TEST(a_slower_line_needs_the_other_outputs_off_first);
    RUN_TEST(the_port_is_found_out);
    RUN_TEST(a_found_port_is_tried_first_the_next_time);
    RUN_TEST(a_wrong_port_is_told);
    RUN_TEST(a_given_port_is_used);
    RUN_TEST(damaged_frames_are_no_wrong_port);
    RUN_TEST(two_wrong_ports_are_told);
    RUN_TEST(frames_of_one_a_second_are_waited_for);
    RUN_TEST(both_notations_of_errors_are_read);
    RUN_TEST(a_refused_setting_is_told_with_its_code);
    RUN_TEST(an_output_that_is_off_may_forget_its_layout);
    RUN_TEST(complaints_of_damage_are_no_refusal);
    RUN_TEST(what_is_echoed_but_not_kept_is_noticed);
    RUN_TEST(a_baud_rate_that_is_not_taken_is_no_stream);
    RUN_TEST(commands_use_the_check_the_sensor_uses);
    RUN_TEST(rests_in_the_sensors_buffer_do_no_harm);
    RUN_TEST(a_late_reply_about_another_register_is_no_answer);
    RUN_TEST(a_slow_line_is_given_its_time);
    RUN_TEST(late_echoes_are_recognised);
    RUN_TEST(noise_ends_in_a_stream_or_is_told);
    RUN_TEST(nothing_at_all_is_silence);
    RUN_TEST(garbage_at_all_speeds_is_unreadable);
    RUN_TEST(a_sensor_that_does_not_listen_is_told);
    RUN_TEST(another_layout_counts_as_a_message);
    RUN_TEST(another_model_is_told);
    RUN_TEST(all_makes_of_the_model_will_do);
    RUN_TEST(a_sensor_that_wakes_late_is_still_found);
    RUN_TEST(a_restart_is_noticed_by_its_ascii_lines);
    RUN_TEST(a_restart_is_noticed_by_the_sensors_clock);
    RUN_TEST(a_restart_at_another_speed_is_noticed_by_silence);
    RUN_TEST(a_wedged_sensor_is_silent_until_it_is_switched);
    RUN_TEST(heading_mode_is_changed_and_nothing_else_of_it);
    RUN_TEST(heading_mode_is_left_alone_when_right_or_not_asked_for);
    RUN_TEST(a_heading_register_that_makes_no_sense_is_not_written);
    RUN_TEST(another_mounting_needs_saving);
    RUN_TEST(the_mounting_it_has_needs_nothing);
    RUN_TEST(mountings_are_rotations);
    RUN_TEST(saving_happens_once_and_only_when_asked);
    RUN_TEST(a_calibration_is_written_when_it_is_whole);
    RUN_TEST(rows_that_make_no_sense_are_refused);
    RUN_TEST(a_save_waits_for_the_stream);
    RUN_TEST(lines_that_nobody_asked_for_change_nothing);
    RUN_TEST(nonsense_in_between_does_not_keep_it_from_the_stream);
    RUN_TEST(suffix_fields_are_tolerated);
    RUN_TEST(configurations_are_checked);
    RUN_TEST(every_problem_has_words);
    RUN_TEST(any_mixture_of_faults_ends_in_a_verdict);
    return UNITY_END();
}
