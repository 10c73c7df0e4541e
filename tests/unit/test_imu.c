/* The IMU in one piece: bytes in, commands and samples out. */
#include "imu/imu.h"

#include "unity.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define PERIOD_US 10000u
#define SECOND_US 1000000u
#define SAMPLES 64u

static const uint8_t HEADER[] = {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00};

static imu_t imu;
static imu_driver_config_t config;
static uint64_t now_us;
static imu_sample_t samples[SAMPLES];
static size_t sample_count;
static uint32_t overruns, random_state;
static char registers[100][64];

static uint32_t random_below(uint32_t limit) {
    random_state = random_state * 1664525u + 1013904223u;
    return (random_state >> 8) % limit;
}

static void put_crc(uint8_t *frame) {
    uint32_t crc = 0;
    for (size_t i = 1; i < 62; i++) {
        crc ^= (uint32_t)frame[i] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) != 0 ? crc << 1 ^ 0x1021u : crc << 1;
        }
    }
    frame[62] = (uint8_t)(crc >> 8);
    frame[63] = (uint8_t)crc;
}

/* A fish that hangs still, but for |accel_x|. */
static void make_frame(uint8_t *frame, uint64_t time_ns, float accel_x) {
    memset(frame, 0, IMU_FRAME_BYTES);
    memcpy(frame, HEADER, sizeof HEADER);
    for (size_t i = 0; i < 8; i++) {
        frame[6 + i] = (uint8_t)(time_ns >> (8 * i));
    }
    memcpy(frame + 38, &accel_x, sizeof accel_x);
    put_crc(frame);
}

static void push(const uint8_t *bytes, size_t length) {
    size_t taken = 0;
    bool got = true;
    while (taken < length || got) {
        imu_sample_t sample;
        const size_t step = imu_push(&imu, bytes + taken, length - taken, now_us, &sample, &got);
        TEST_ASSERT_TRUE(step <= length - taken && (got || step == length - taken));
        taken += step;
        if (got) {
            samples[sample_count % SAMPLES] = sample;
            sample_count++;
        }
    }
}

static void push_line(const char *body) {
    uint8_t sum = 0;
    for (const char *c = body; *c != 0; c++) {
        sum = (uint8_t)(sum ^ (uint8_t)*c);
    }
    char line[120];
    const int length = snprintf(line, sizeof line, "$%s*%02X\r\n", body, sum);
    push((const uint8_t *)line, (size_t)length);
}

static void push_frame(uint64_t time_ns) {
    uint8_t frame[IMU_FRAME_BYTES];
    make_frame(frame, time_ns, 0.5f);
    push(frame, sizeof frame);
}

/* Does as it is told, at any speed. */
static void obey(const imu_action_t *action) {
    char body[120];
    const char *dollar = memchr(action->bytes, '$', action->length);
    const size_t length = strcspn(dollar + 1, "*");
    TEST_ASSERT_TRUE(length < sizeof body);
    memcpy(body, dollar + 1, length);
    body[length] = 0;
    const int number = length >= 8 ? atoi(body + 6) : 0;
    if (strncmp(body, "VNWRG", 5) == 0) {
        TEST_ASSERT_TRUE(length - 9 < sizeof registers[0]);
        memcpy(registers[number], body + 9, length - 8);
    } else if (strncmp(body, "VNRRG", 5) == 0) {
        (void)snprintf(body, sizeof body, "VNRRG,%02d,%s", number, registers[number]);
    }
    push_line(body);
}

static void poll(bool answer) {
    for (unsigned i = 0; i < 8; i++) {
        const imu_action_t action = imu_poll(&imu, overruns, now_us);
        if (action.what == IMU_DO_NOTHING) {
            return;
        }
        if (action.what == IMU_DO_SEND && answer) {
            obey(&action);
        }
    }
}

static void wait_us(uint64_t time_us, bool answer) {
    for (const uint64_t end_us = now_us + time_us; now_us < end_us;) {
        now_us += 1000;
        poll(answer);
    }
}

void setUp(void) {
    now_us = 40000000;
    sample_count = 0;
    overruns = 0;
    random_state = 2024;
    memset(registers, 0, sizeof registers);
    memcpy(registers[1], "VN-100S", 8);
    memcpy(registers[4], "2.1.0.0", 8);
    config = (imu_driver_config_t){.baud = 115200, .rate_hz = 100, .heading = -1};
    imu_init(&imu, &config, now_us);
}

void tearDown(void) {}

/* Leaves it streaming, with one frame seen, of sensor time |time_ns|. */
static void set_up(uint64_t time_ns) {
    wait_us(100000, true);
    TEST_ASSERT_EQUAL_INT(IMU_WAITING, imu.driver.state);
    push_frame(time_ns);
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, imu.driver.state);
    TEST_ASSERT_EQUAL_size_t(1, sample_count);
}

static void it_is_set_up_by_what_it_sends_and_gets(void) {
    TEST_ASSERT_EQUAL_HEX16(IMU_HEALTH_SILENT | IMU_HEALTH_NOT_SET_UP, imu.health);
    set_up(1000000);
    poll(false);
    TEST_ASSERT_EQUAL_HEX16(0, imu.health);
    TEST_ASSERT_EQUAL_STRING("2,8,11,0129,0040", registers[75]);
    TEST_ASSERT_EQUAL_INT(IMU_STEP_FIRST, samples[0].step);
    TEST_ASSERT_TRUE(samples[0].time_us == now_us);
    TEST_ASSERT_EQUAL_FLOAT(0.5f, samples[0].frame.accel_m_s2[0]);
    TEST_ASSERT_EQUAL_UINT32(1, imu.counters.frames);
    TEST_ASSERT_TRUE(imu.last_us == now_us && imu.last.time_startup_ns == 1000000);
}

static void any_chunking_gives_all_samples(void) {
    static const size_t CHUNKS[] = {1, 7, 63, 64, 65, 10000};
    static const char LINE[] = "$VNERR,03*72\r\n";
    static uint8_t stream[20 * 80];
    for (size_t c = 0; c < sizeof CHUNKS / sizeof CHUNKS[0]; c++) {
        setUp();
        set_up(1);
        size_t length = 0;
        for (uint64_t i = 1; i <= 20; i++) {
            make_frame(stream + length, 1 + i * PERIOD_US * 1000, 0.25f);
            length += IMU_FRAME_BYTES;
            if (i % 5 == 0) {
                memcpy(stream + length, LINE, sizeof LINE - 1);
                length += sizeof LINE - 1;
            }
        }
        for (size_t at = 0; at < length; at += CHUNKS[c]) {
            push(stream + at, length - at < CHUNKS[c] ? length - at : CHUNKS[c]);
        }
        TEST_ASSERT_EQUAL_size_t(21, sample_count);
        for (size_t i = 1; i <= 20; i++) {
            TEST_ASSERT_EQUAL_INT(IMU_STEP_NEXT, samples[i].step);
            TEST_ASSERT_EQUAL_FLOAT(0.01f, samples[i].dt_s);
        }
        TEST_ASSERT_EQUAL_UINT32(4, imu.driver.errors);
        TEST_ASSERT_EQUAL_UINT32(0, imu.reader.counters.skipped_bytes);
    }
}

/* The begin of a frame, then silence, then a whole one: nothing of it waits for the next. */
static void a_half_frame_is_given_up_after_a_silence(void) {
    set_up(1);
    uint8_t frame[IMU_FRAME_BYTES];
    make_frame(frame, 10000001, 0.5f);
    push(frame, 40);
    wait_us(20000, false);
    TEST_ASSERT_EQUAL_UINT16(40, imu.reader.held);
    wait_us(1000, false);
    TEST_ASSERT_EQUAL_UINT16(0, imu.reader.held);
    TEST_ASSERT_EQUAL_UINT32(1, imu.reader.counters.dropped);
    push_frame(30000001);
    TEST_ASSERT_EQUAL_size_t(2, sample_count);
    TEST_ASSERT_EQUAL_INT(IMU_STEP_GAP, samples[1].step);
    TEST_ASSERT_EQUAL_UINT32(2, imu.sequence.lost);
}

static void what_came_at_another_speed_is_dropped(void) {
    uint8_t frame[IMU_FRAME_BYTES];
    make_frame(frame, 1, 0.5f);
    push(frame, 40);
    TEST_ASSERT_EQUAL_INT(IMU_DO_SET_BAUD, imu_poll(&imu, 0, now_us).what);
    TEST_ASSERT_EQUAL_UINT16(0, imu.reader.held);
}

static void a_pause_of_the_main_loop_is_no_silence(void) {
    set_up(1);
    uint8_t frames[2][IMU_FRAME_BYTES];
    make_frame(frames[0], 10000001, 0.5f);
    make_frame(frames[1], 20000001, 0.5f);
    push(frames[0], 40);
    poll(false);
    now_us += 100000;
    push(frames[0] + 40, 24 + 40);
    poll(false);
    push(frames[1] + 40, 24);
    TEST_ASSERT_EQUAL_size_t(3, sample_count);
    TEST_ASSERT_EQUAL_UINT32(0, imu.reader.counters.skipped_bytes);
}

static void a_line_behind_a_half_frame_is_heard_after_the_silence(void) {
    set_up(1);
    push(HEADER, sizeof HEADER);
    push_line("VNYMR,+100.949,-011.161,-000.040,+01.0640");
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, imu.driver.state);
    wait_us(25000, false);
    TEST_ASSERT_EQUAL_INT(IMU_SEARCHING, imu.driver.state);
}

static void impossible_values_are_counted_and_not_handed_out(void) {
    set_up(1);
    for (uint64_t i = 1; i <= 100; i++) {
        uint8_t frame[IMU_FRAME_BYTES];
        make_frame(frame, i * 10000000, 200.0f);
        wait_us(PERIOD_US, false);
        push(frame, sizeof frame);
    }
    poll(false);
    TEST_ASSERT_EQUAL_size_t(1, sample_count);
    TEST_ASSERT_EQUAL_UINT32(100, imu.counters.implausible);
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, imu.driver.state);
    TEST_ASSERT_EQUAL_HEX16(IMU_HEALTH_SILENT, imu.health & 0xFF00u);
}

/* What came before it was set up may have had any rate. */
static void lost_frames_are_counted_once_it_is_set_up(void) {
    push_frame(1);
    push_frame(50000001);
    TEST_ASSERT_EQUAL_UINT32(0, imu.sequence.lost);
    sample_count = 0;
    set_up(900000001);
    TEST_ASSERT_EQUAL_UINT32(0, imu.sequence.lost);
    push_frame(910000001);
    push_frame(950000001);
    TEST_ASSERT_EQUAL_UINT32(3, imu.sequence.lost);
    TEST_ASSERT_EQUAL_INT(IMU_STEP_GAP, samples[2].step);
    TEST_ASSERT_EQUAL_FLOAT(0.04f, samples[2].dt_s);
}

static void a_restarted_sensor_is_set_up_again(void) {
    set_up(5000000000ull);
    push_frame(1000);
    TEST_ASSERT_EQUAL_INT(IMU_STEP_RESTART, samples[1].step);
    TEST_ASSERT_EQUAL_FLOAT(0.0f, samples[1].dt_s);
    TEST_ASSERT_TRUE(samples[1].time_us == now_us);
    TEST_ASSERT_EQUAL_UINT32(1, imu.sequence.restarts);
    TEST_ASSERT_EQUAL_INT(IMU_SEARCHING, imu.driver.state);
    sample_count = 0;
    set_up(2000);
}

static void another_configuration_sets_it_up_again(void) {
    set_up(1);
    config.rate_hz = 50;
    imu_configure(&imu, &config, now_us);
    TEST_ASSERT_EQUAL_INT(IMU_SEARCHING, imu.driver.state);
    sample_count = 0;
    set_up(500000001);
    TEST_ASSERT_EQUAL_STRING("2,16,11,0129,0040", registers[75]);
    push_frame(520000001);
    TEST_ASSERT_EQUAL_UINT32(0, imu.sequence.lost);
    TEST_ASSERT_EQUAL_UINT32(3, imu.counters.frames);
}

/* Frames are made every 10 ms of the sensor's clock, which runs |ppm| fast; they reach us up to 3
 * ms later, and now and then all those of 100 ms together. */
static void assert_times_followed(int32_t ppm, uint32_t frames) {
    setUp();
    set_up(1);
    const uint64_t begin_us = now_us;
    uint64_t last_time_us = 0, blocked_until_us = 0;
    for (uint32_t i = 1; i <= frames; i++) {
        const uint64_t sensor_us = (uint64_t)i * PERIOD_US;
        const int64_t fast_us = (int64_t)sensor_us * ppm / 1000000;
        const uint64_t made_us = begin_us + (uint64_t)((int64_t)sensor_us - fast_us);
        if (i % 997 == 0) {
            blocked_until_us = made_us + 100000;
        }
        const uint64_t earliest_us = made_us + random_below(3000);
        now_us = earliest_us > blocked_until_us ? earliest_us : blocked_until_us;
        push_frame(1 + sensor_us * 1000);
        (void)imu_poll(&imu, 0, now_us);
        const uint64_t time_us = samples[(sample_count - 1) % SAMPLES].time_us;
        TEST_ASSERT_TRUE(time_us <= now_us && time_us >= last_time_us);
        last_time_us = time_us;
        if (i > 200) {
            TEST_ASSERT_INT64_WITHIN(300, (int64_t)made_us, (int64_t)time_us);
        }
    }
    TEST_ASSERT_EQUAL_INT(IMU_STREAMING, imu.driver.state);
    TEST_ASSERT_EQUAL_UINT32(0, imu.sequence.lost);
}

static void times_follow_the_sensors_clock_not_the_arrivals(void) {
    assert_times_followed(0, 12000);
    assert_times_followed(70, 12000);
    assert_times_followed(-70, 12000);
}

/* On its RC oscillator the board is percents off: no fine times, but none that run away. */
static void clocks_that_part_quickly_stay_together_roughly(void) {
    set_up(1);
    for (uint64_t i = 1; i <= 6000; i++) {
        now_us += PERIOD_US + 300;
        push_frame(1 + i * PERIOD_US * 1000);
        (void)imu_poll(&imu, 0, now_us);
        const uint64_t time_us = samples[(sample_count - 1) % SAMPLES].time_us;
        TEST_ASSERT_TRUE(time_us <= now_us && now_us - time_us <= 501000);
    }
}

static void sensor_times_of_any_size_are_divided_right(void) {
    static const uint64_t TIMES_NS[] = {999, 4294967295999ull, 4294967296000ull,
                                        123456789012345678ull, 18446744073000000000ull};
    for (size_t i = 0; i < sizeof TIMES_NS / sizeof TIMES_NS[0]; i++) {
        setUp();
        set_up(TIMES_NS[i]);
        const uint64_t first_us = now_us;
        now_us += 15000;
        push_frame(TIMES_NS[i] + 12345678);
        const uint64_t step_us = (TIMES_NS[i] + 12345678) / 1000 - TIMES_NS[i] / 1000;
        TEST_ASSERT_UINT64_WITHIN(1, first_us + step_us, samples[1].time_us);
    }
}

static void stream_for_us(uint64_t time_us) {
    for (const uint64_t end_us = now_us + time_us; now_us < end_us;) {
        wait_us(PERIOD_US, false);
        push_frame(imu.last.time_startup_ns + PERIOD_US * 1000);
    }
}

static void assert_health_after_span(uint16_t expected) {
    stream_for_us(IMU_HEALTH_SPAN_US);
    TEST_ASSERT_EQUAL_HEX16(expected, imu.health);
    stream_for_us(IMU_HEALTH_SPAN_US + 2 * PERIOD_US);
    TEST_ASSERT_EQUAL_HEX16(0, imu.health);
}

static void the_health_word_tells_what_happened_in_the_last_span(void) {
    set_up(1);
    stream_for_us(2 * IMU_HEALTH_SPAN_US);
    TEST_ASSERT_EQUAL_HEX16(0, imu.health);

    uint8_t frame[IMU_FRAME_BYTES];
    make_frame(frame, imu.last.time_startup_ns + 10000000, 0.5f);
    frame[20] ^= 1u;
    push(frame, sizeof frame);
    assert_health_after_span(IMU_HEALTH_DAMAGED | IMU_HEALTH_REJECTS);

    push((const uint8_t *)"$VNERR,03*73\r\n", 14);
    assert_health_after_span(IMU_HEALTH_DAMAGED | IMU_HEALTH_REJECTS);

    push((const uint8_t *)"x", 1);
    assert_health_after_span(IMU_HEALTH_REJECTS);

    push_frame(imu.last.time_startup_ns + 50000000);
    assert_health_after_span(IMU_HEALTH_LOST);

    overruns = 3;
    assert_health_after_span(IMU_HEALTH_OVERRUN);

    make_frame(frame, imu.last.time_startup_ns + 1, 1000.0f);
    push(frame, sizeof frame);
    assert_health_after_span(IMU_HEALTH_IMPLAUSIBLE);

    push_frame(5);
    wait_us(100000, true);
    assert_health_after_span(IMU_HEALTH_RESTARTED);
}

static void silence_is_told_at_once(void) {
    set_up(1);
    stream_for_us(100000);
    wait_us(500000, false);
    TEST_ASSERT_EQUAL_HEX16(0, imu.health & 0xFF00u);
    wait_us(2000, false);
    TEST_ASSERT_EQUAL_HEX16(IMU_HEALTH_SILENT | IMU_HEALTH_NOT_SET_UP, imu.health & 0xFF00u);
}

/* A sensor somebody else has set to another layout, and whose RX is not connected. */
static void frames_of_another_layout_tell_that_it_sends(void) {
    /* The manual's worked example: yaw, pitch, roll. */
    static const uint8_t OTHER[] = {0xFA, 0x01, 0x08, 0x00, 0x93, 0x50, 0x2E, 0x42, 0x83,
                                    0x3E, 0xF1, 0x3F, 0x48, 0xB5, 0x04, 0xBB, 0x92, 0x88};
    for (int i = 0; i < 500; i++) {
        wait_us(PERIOD_US, false);
        push(OTHER, sizeof OTHER);
    }
    TEST_ASSERT_EQUAL_INT(IMU_PROBLEM_NO_REPLY, imu.driver.problem);
    TEST_ASSERT_EQUAL_size_t(0, sample_count);
    sample_count = 0;
    wait_us(3 * SECOND_US, true);
    push_frame(7);
    TEST_ASSERT_EQUAL_size_t(1, sample_count);
}

static void garbage_ends_no_program(void) {
    static uint8_t garbage[200];
    static const uint8_t LIKELY[] = {0xFA, 0x11, 0x29, '$', 'V', 'N', '*', '\r', '\n', ','};
    for (int round = 0; round < 2000; round++) {
        for (size_t i = 0; i < sizeof garbage; i++) {
            const uint32_t draw = random_below(1u << 16);
            garbage[i] = draw % 2 == 0 ? LIKELY[draw / 2 % sizeof LIKELY] : (uint8_t)(draw >> 4);
        }
        push(garbage, 1u + random_below(sizeof garbage));
        wait_us(random_below(30000), false);
    }
    TEST_ASSERT_EQUAL_size_t(0, sample_count);
    TEST_ASSERT_TRUE(imu.driver.problem == IMU_PROBLEM_UNREADABLE ||
                     imu.driver.problem == IMU_PROBLEM_NO_REPLY);
    push((const uint8_t *)"\n", 1);
    wait_us(5 * SECOND_US, true);
    push_frame(7);
    TEST_ASSERT_EQUAL_size_t(1, sample_count);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(it_is_set_up_by_what_it_sends_and_gets);
    RUN_TEST(any_chunking_gives_all_samples);
    RUN_TEST(a_half_frame_is_given_up_after_a_silence);
    RUN_TEST(what_came_at_another_speed_is_dropped);
    RUN_TEST(a_pause_of_the_main_loop_is_no_silence);
    RUN_TEST(a_line_behind_a_half_frame_is_heard_after_the_silence);
    RUN_TEST(impossible_values_are_counted_and_not_handed_out);
    RUN_TEST(lost_frames_are_counted_once_it_is_set_up);
    RUN_TEST(a_restarted_sensor_is_set_up_again);
    RUN_TEST(another_configuration_sets_it_up_again);
    RUN_TEST(times_follow_the_sensors_clock_not_the_arrivals);
    RUN_TEST(clocks_that_part_quickly_stay_together_roughly);
    RUN_TEST(sensor_times_of_any_size_are_divided_right);
    RUN_TEST(the_health_word_tells_what_happened_in_the_last_span);
    RUN_TEST(silence_is_told_at_once);
    RUN_TEST(frames_of_another_layout_tell_that_it_sends);
    RUN_TEST(garbage_ends_no_program);
    return UNITY_END();
}
