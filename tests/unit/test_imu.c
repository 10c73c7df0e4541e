#include "imu/imu.h"

#include "unity.h"

#include <math.h>
#include <string.h>

#define FRAMES 20u
#define STREAM_BYTES (FRAMES * IMU_FRAME_BYTES)
/* One damaged frame in 65536 has the right CRC by chance; from this time on none of ours has. */
#define STARTUP_NS 987654321000ull
#define STEP_NS 10000000ull

/* Synthetic, computed by hand from the layout in the manual. */
static const uint8_t EXAMPLE[IMU_FRAME_BYTES] = {
    0xFA, 0x11, 0x29, 0x01, 0x40, 0x00, 0x08, 0x1A, 0x99, 0xBE, 0x1C, 0x00, 0x00, 0x00, 0x00, 0x00,
    0x20, 0x41, 0x00, 0x00, 0x20, 0xC0, 0x00, 0x00, 0x40, 0x3F, 0x0A, 0xD7, 0x23, 0x3C, 0x0A, 0xD7,
    0xA3, 0xBC, 0x00, 0x00, 0x00, 0x3F, 0x21, 0xB0, 0xD2, 0xBE, 0x8A, 0xB0, 0xC1, 0xBE, 0xC4, 0xB1,
    0x1C, 0xC1, 0x6F, 0x12, 0x83, 0x3C, 0x00, 0x00, 0x80, 0xBE, 0x6F, 0x12, 0x83, 0x3B, 0x93, 0x1E,
};

static imu_t imu;
static imu_frame_t found[4u * FRAMES];
static size_t found_count;
static uint32_t random_state;

void setUp(void) {
    imu_init(&imu);
    found_count = 0;
    random_state = 12345u;
}

void tearDown(void) {}

static uint32_t random_u32(void) {
    random_state = random_state * 1664525u + 1013904223u;
    return random_state >> 8;
}

static uint16_t slow_crc(const uint8_t *bytes, size_t length) {
    uint32_t crc = 0;
    for (size_t i = 0; i < length; i++) {
        crc ^= (uint32_t)bytes[i] << 8;
        for (int bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) != 0 ? (crc << 1) ^ 0x1021u : crc << 1;
        }
    }
    return (uint16_t)crc;
}

static void seal(uint8_t *bytes) {
    const uint16_t crc = slow_crc(bytes + 1, IMU_FRAME_BYTES - 3u);
    bytes[62] = (uint8_t)(crc >> 8);
    bytes[63] = (uint8_t)crc;
}

static void put_float(uint8_t *frame, size_t offset, float value) {
    memcpy(frame + offset, &value, sizeof value);
    seal(frame);
}

static void put_time(uint8_t *frame, uint64_t time_ns) {
    for (size_t i = 0; i < 8; i++) {
        frame[6 + i] = (uint8_t)(time_ns >> (8 * i));
    }
    seal(frame);
}

/* Frames like the example, in time order; some floats hold sync bytes, as real streams do. */
static void make_stream(uint8_t *stream, size_t frames) {
    for (size_t i = 0; i < frames; i++) {
        uint8_t *frame = stream + i * IMU_FRAME_BYTES;
        memcpy(frame, EXAMPLE, IMU_FRAME_BYTES);
        frame[14] = 0xFA;
        frame[50] = i % 2 == 0 ? 0xFA : (uint8_t)i;
        frame[51] = 0x11;
        put_time(frame, STARTUP_NS + i * STEP_NS);
    }
}

/* Pushes in pieces of |chunk| as a caller does and keeps what comes out. */
static void push(const uint8_t *bytes, size_t length, size_t chunk) {
    for (size_t begin = 0; begin < length; begin += chunk) {
        const size_t piece = length - begin < chunk ? length - begin : chunk;
        size_t taken = 0;
        while (taken < piece) {
            imu_frame_t frame;
            bool got = false;
            const size_t step = imu_push(&imu, bytes + begin + taken, piece - taken, &frame, &got);
            TEST_ASSERT_TRUE(step > 0 && step <= piece - taken);
            taken += step;
            if (got) {
                TEST_ASSERT_TRUE(found_count < sizeof found / sizeof found[0]);
                found[found_count++] = frame;
            }
        }
    }
}

static void assert_all_bytes_accounted(size_t pushed) {
    const size_t in_frames =
        (size_t)(imu.counters.frames + imu.counters.implausible) * IMU_FRAME_BYTES;
    TEST_ASSERT_EQUAL_size_t(pushed, in_frames + imu.counters.skipped_bytes + imu.held);
}

/* All frames of the stream came out in order, but for number |lost| (FRAMES = none). */
static void assert_only_lost(size_t lost) {
    size_t next = 0;
    for (size_t i = 0; i < FRAMES; i++) {
        if (i == lost) {
            continue;
        }
        TEST_ASSERT_TRUE(next < found_count);
        TEST_ASSERT_TRUE(found[next].time_startup_ns == STARTUP_NS + i * STEP_NS);
        next++;
    }
    TEST_ASSERT_EQUAL_size_t(next, found_count);
}

static void example_gives_its_values(void) {
    push(EXAMPLE, sizeof EXAMPLE, sizeof EXAMPLE);
    TEST_ASSERT_EQUAL_size_t(1, found_count);
    TEST_ASSERT_TRUE(found[0].time_startup_ns == 123456789000ull);
    const float ypr[] = {10.0f, -2.5f, 0.75f};
    const float rate[] = {0.01f, -0.02f, 0.5f};
    const float accel[] = {-0.4115f, -0.3783f, -9.7934f};
    const float linear[] = {0.016f, -0.25f, 0.004f};
    for (size_t axis = 0; axis < 3; axis++) {
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, ypr[axis], found[0].ypr_deg[axis]);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, rate[axis], found[0].rate_rad_s[axis]);
        TEST_ASSERT_FLOAT_WITHIN(1e-4f, accel[axis], found[0].accel_m_s2[axis]);
        TEST_ASSERT_FLOAT_WITHIN(1e-6f, linear[axis], found[0].linear_accel_m_s2[axis]);
    }
}

static void any_chunking_gives_all_frames(void) {
    const size_t chunks[] = {1, 2, 5, 7, 63, 64, 65, 128, STREAM_BYTES};
    static uint8_t stream[STREAM_BYTES];
    make_stream(stream, FRAMES);
    for (size_t i = 0; i < sizeof chunks / sizeof chunks[0]; i++) {
        setUp();
        push(stream, sizeof stream, chunks[i]);
        assert_only_lost(FRAMES);
        TEST_ASSERT_EQUAL_UINT32(0, imu.counters.skipped_bytes);
        TEST_ASSERT_EQUAL_UINT32(0, imu.counters.crc_failed);
    }
}

static void a_frame_may_be_split_anywhere(void) {
    static uint8_t stream[STREAM_BYTES];
    make_stream(stream, FRAMES);
    for (size_t split = 1; split < 2 * IMU_FRAME_BYTES; split++) {
        setUp();
        push(stream, split, STREAM_BYTES);
        push(stream + split, sizeof stream - split, STREAM_BYTES);
        assert_only_lost(FRAMES);
    }
}

static void starting_mid_frame_loses_only_that_frame(void) {
    static uint8_t stream[STREAM_BYTES];
    make_stream(stream, FRAMES);
    for (size_t begin = 1; begin < IMU_FRAME_BYTES; begin++) {
        setUp();
        push(stream + begin, sizeof stream - begin, 7);
        assert_only_lost(0);
        TEST_ASSERT_EQUAL_UINT32(IMU_FRAME_BYTES - begin, imu.counters.skipped_bytes);
    }
}

/* Which of several equal bytes in a row is gone nobody can tell: the last of the run is as good. */
static size_t end_of_run(const uint8_t *stream, size_t at) {
    size_t last = at;
    while (last + 1 < STREAM_BYTES && stream[last + 1] == stream[at]) {
        last++;
    }
    return last;
}

/* Whether |stray| put in at |at| is the same as put in between two frames. */
static bool falls_between_frames(const uint8_t *stream, size_t at, uint8_t stray) {
    size_t first = at, last = at;
    while (first > 0 && stream[first - 1] == stray) {
        first--;
    }
    while (last < STREAM_BYTES && stream[last] == stray) {
        last++;
    }
    return last / IMU_FRAME_BYTES * IMU_FRAME_BYTES >= first;
}

static void every_deletion_loses_one_frame(void) {
    const size_t chunks[] = {1, 7, 64, STREAM_BYTES};
    static uint8_t stream[STREAM_BYTES], cut[STREAM_BYTES];
    make_stream(stream, FRAMES);
    for (size_t at = 0; at < STREAM_BYTES - IMU_FRAME_BYTES; at++) {
        memcpy(cut, stream, at);
        memcpy(cut + at, stream + at + 1, sizeof stream - at - 1);
        for (size_t c = 0; c < sizeof chunks / sizeof chunks[0]; c++) {
            setUp();
            push(cut, sizeof cut - 1, chunks[c]);
            assert_only_lost(end_of_run(stream, at) / IMU_FRAME_BYTES);
            assert_all_bytes_accounted(sizeof cut - 1);
        }
    }
}

static void every_insertion_loses_at_most_the_touched_frame(void) {
    const uint8_t strays[] = {0x00, 0xFA, 0x11};
    static uint8_t stream[STREAM_BYTES], longer[STREAM_BYTES + 1];
    make_stream(stream, FRAMES);
    for (size_t at = 0; at <= STREAM_BYTES - IMU_FRAME_BYTES; at++) {
        for (size_t s = 0; s < sizeof strays; s++) {
            memcpy(longer, stream, at);
            longer[at] = strays[s];
            memcpy(longer + at + 1, stream + at, sizeof stream - at);
            const bool harmless = falls_between_frames(stream, at, strays[s]);
            setUp();
            push(longer, sizeof longer, 1 + at % 70);
            assert_only_lost(harmless ? FRAMES : at / IMU_FRAME_BYTES);
            assert_all_bytes_accounted(sizeof longer);
        }
    }
}

static void every_flipped_bit_loses_one_frame(void) {
    static uint8_t stream[STREAM_BYTES];
    make_stream(stream, FRAMES);
    for (size_t at = 0; at < STREAM_BYTES; at++) {
        for (int bit = 0; bit < 8; bit++) {
            stream[at] = (uint8_t)(stream[at] ^ (1u << bit));
            setUp();
            push(stream, sizeof stream, STREAM_BYTES);
            assert_only_lost(at / IMU_FRAME_BYTES);
            assert_all_bytes_accounted(sizeof stream);
            stream[at] = (uint8_t)(stream[at] ^ (1u << bit));
        }
    }
}

static void garbage_gives_no_frame_and_hides_none(void) {
    static uint8_t garbage[100000];
    const uint8_t likely[] = {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00};
    for (size_t i = 0; i < sizeof garbage; i++) {
        const uint32_t draw = random_u32();
        garbage[i] = draw % 4 == 0 ? likely[draw / 4 % sizeof likely] : (uint8_t)(draw >> 4);
    }
    push(garbage, sizeof garbage, 61);
    TEST_ASSERT_EQUAL_size_t(0, found_count);
    assert_all_bytes_accounted(sizeof garbage);

    static uint8_t stream[STREAM_BYTES];
    make_stream(stream, FRAMES);
    push(stream, sizeof stream, 61);
    assert_only_lost(FRAMES);
}

static void a_false_header_hides_no_frame(void) {
    static uint8_t stream[STREAM_BYTES];
    make_stream(stream, FRAMES);
    for (size_t length = 1; length < IMU_FRAME_BYTES; length++) {
        setUp();
        push(EXAMPLE, length, 64);
        push(stream, sizeof stream, 64);
        assert_only_lost(FRAMES);
        TEST_ASSERT_EQUAL_UINT32(length, imu.counters.skipped_bytes);
        TEST_ASSERT_EQUAL_UINT32(length >= 6 ? 1 : 0, imu.counters.crc_failed);
    }
}

/* A sync byte alone must not hold back what follows. */
static void a_frame_is_delivered_with_its_last_byte(void) {
    uint8_t bytes[3 + IMU_FRAME_BYTES] = {0xFA, 0x11, 0x29};
    memcpy(bytes + 3, EXAMPLE, IMU_FRAME_BYTES);
    push(bytes, sizeof bytes - 1, 1);
    TEST_ASSERT_EQUAL_size_t(0, found_count);
    push(bytes + sizeof bytes - 1, 1, 1);
    TEST_ASSERT_EQUAL_size_t(1, found_count);
    TEST_ASSERT_EQUAL_UINT8(0, imu.held);
}

static void many_sync_bytes_hold_nothing_back(void) {
    uint8_t bytes[40 + IMU_FRAME_BYTES];
    memset(bytes, 0xFA, 40);
    memcpy(bytes + 40, EXAMPLE, IMU_FRAME_BYTES);
    push(bytes, sizeof bytes, sizeof bytes);
    TEST_ASSERT_EQUAL_size_t(1, found_count);
    TEST_ASSERT_EQUAL_UINT32(40, imu.counters.skipped_bytes);
}

static void push_stops_at_the_end_of_a_frame(void) {
    static uint8_t stream[STREAM_BYTES];
    make_stream(stream, FRAMES);
    imu_frame_t frame;
    bool got = false;
    TEST_ASSERT_EQUAL_size_t(64, imu_push(&imu, stream, sizeof stream, &frame, &got));
    TEST_ASSERT_TRUE(got);
    TEST_ASSERT_EQUAL_size_t(0, imu_push(&imu, stream, 0, &frame, &got));
    TEST_ASSERT_FALSE(got);
}

static void assert_value_dropped(size_t offset, float value, bool dropped) {
    setUp();
    uint8_t frame[IMU_FRAME_BYTES];
    memcpy(frame, EXAMPLE, sizeof frame);
    put_float(frame, offset, value);
    push(frame, sizeof frame, sizeof frame);
    TEST_ASSERT_EQUAL_size_t(dropped ? 0 : 1, found_count);
    TEST_ASSERT_EQUAL_UINT32(dropped ? 1 : 0, imu.counters.implausible);
    TEST_ASSERT_EQUAL_UINT32(0, imu.counters.crc_failed);
}

static void impossible_values_drop_the_frame(void) {
    for (size_t offset = 14; offset < 62; offset += 4) {
        assert_value_dropped(offset, NAN, true);
        assert_value_dropped(offset, INFINITY, true);
        assert_value_dropped(offset, -INFINITY, true);
    }
    assert_value_dropped(18, 90.0f, false);
    assert_value_dropped(18, -90.1f, true);
    for (size_t axis = 0; axis < 3; axis++) {
        assert_value_dropped(26 + 4 * axis, -34.9f, false);
        assert_value_dropped(26 + 4 * axis, 35.0f, true);
        assert_value_dropped(38 + 4 * axis, 156.9f, false);
        assert_value_dropped(38 + 4 * axis, -157.1f, true);
        assert_value_dropped(50 + 4 * axis, 166.0f, false);
        assert_value_dropped(50 + 4 * axis, 168.0f, true);
    }
}

static void push_at(uint64_t time_ns) {
    uint8_t frame[IMU_FRAME_BYTES];
    memcpy(frame, EXAMPLE, sizeof frame);
    put_time(frame, time_ns);
    push(frame, sizeof frame, sizeof frame);
}

static void a_repeated_time_drops_the_frame(void) {
    push_at(5000);
    push_at(5000);
    TEST_ASSERT_EQUAL_size_t(1, found_count);
    TEST_ASSERT_EQUAL_UINT32(1, imu.counters.implausible);
    push_at(5001);
    TEST_ASSERT_EQUAL_size_t(2, found_count);
}

static void a_sensor_restart_costs_one_frame(void) {
    push_at(900000000000ull);
    push_at(1000);
    TEST_ASSERT_EQUAL_size_t(1, found_count);
    push_at(2000);
    push_at(3000);
    TEST_ASSERT_EQUAL_size_t(3, found_count);
    TEST_ASSERT_EQUAL_UINT32(1, imu.counters.implausible);
}

static void the_first_frame_may_have_time_zero(void) {
    push_at(0);
    push_at(1);
    TEST_ASSERT_EQUAL_size_t(2, found_count);
}

int main(void) {
    UNITY_BEGIN();
    RUN_TEST(example_gives_its_values);
    RUN_TEST(any_chunking_gives_all_frames);
    RUN_TEST(a_frame_may_be_split_anywhere);
    RUN_TEST(starting_mid_frame_loses_only_that_frame);
    RUN_TEST(every_deletion_loses_one_frame);
    RUN_TEST(every_insertion_loses_at_most_the_touched_frame);
    RUN_TEST(every_flipped_bit_loses_one_frame);
    RUN_TEST(garbage_gives_no_frame_and_hides_none);
    RUN_TEST(a_false_header_hides_no_frame);
    RUN_TEST(a_frame_is_delivered_with_its_last_byte);
    RUN_TEST(many_sync_bytes_hold_nothing_back);
    RUN_TEST(push_stops_at_the_end_of_a_frame);
    RUN_TEST(impossible_values_drop_the_frame);
    RUN_TEST(a_repeated_time_drops_the_frame);
    RUN_TEST(a_sensor_restart_costs_one_frame);
    RUN_TEST(the_first_frame_may_have_time_zero);
    return UNITY_END();
}
