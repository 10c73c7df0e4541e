/*
 * Bytes of the VN-100's line into the reader and the driver, with the time between them.
 *
 * Each step of the input is a byte that says what, then its arguments: raw bytes, a frame or a line
 * whose check is made right, the echo of the driver's last command as a sensor sends it, the answer
 * to a read, time passing, the wish to save.
 *
 * Held against it: what comes out is what a second reader, fed one byte at a time, gets; every byte
 * is accounted for; samples are finite, within the sensor's limits and not from the future; the
 * driver asks for known speeds and complete lines, a bounded number of them, and has a verdict
 * within IMU_DRIVER_VERDICT_US.
 */
#include "fuzz.h"

#include "base/real.h"
#include "imu/imu.h"
#include "store/bytes.h"

#define STEPS_MAX 400u
#define ACTIONS_MAX 8u
#define PASS_US 10000u
#define CHUNK_BYTES 300u

static imu_t imu;
static imu_reader_t slow; /* the same stream, a byte at a time */
static uint64_t now_us, bytes_pushed, problem_since_us;
static uint32_t frames_seen;
static char command[IMU_COMMAND_MAX_BYTES + 1];
static uint16_t command_bytes;

static uint16_t crc16(const uint8_t *bytes, size_t length) {
    unsigned crc = 0;
    for (size_t i = 0; i < length; i++) {
        crc ^= (unsigned)bytes[i] << 8;
        for (unsigned bit = 0; bit < 8; bit++) {
            crc = (crc & 0x8000u) != 0 ? crc << 1 ^ 0x1021u : crc << 1;
        }
    }
    return (uint16_t)crc;
}

static void sound(const imu_sample_t *sample) {
    const imu_frame_t *frame = &sample->frame;
    for (unsigned i = 0; i < 3; i++) {
        MUST(real_is_finite(frame->ypr_deg[i]));
        MUST(real_abs(frame->rate_rad_s[i]) <= IMU_RATE_MAX_RAD_S);
        MUST(real_abs(frame->accel_m_s2[i]) <= IMU_ACCEL_MAX_M_S2);
        MUST(real_abs(frame->linear_accel_m_s2[i]) <= IMU_LINEAR_ACCEL_MAX_M_S2);
    }
    MUST(real_abs(frame->ypr_deg[1]) <= IMU_PITCH_MAX_DEG);
    MUST(real_is_finite(sample->dt_s) && sample->dt_s >= 0.0f);
    MUST(sample->step <= IMU_STEP_RESTART);
    MUST(sample->time_us <= now_us || sample->time_us > UINT64_MAX / 2u);
    frames_seen++;
}

static void slowly(const uint8_t *bytes, size_t length) {
    for (size_t i = 0; i < length; i++) {
        size_t taken = 0;
        bool got = true;
        while (taken < 1 || got) {
            imu_message_t message;
            taken += imu_reader_push(&slow, bytes + i, 1 - taken, &message, &got);
        }
    }
}

static void alike(void) {
    const imu_reader_counters_t *a = &imu.reader.counters, *b = &slow.counters;
    MUST(memcmp(a, b, sizeof *a) == 0);
    MUST(a->skipped_bytes <= bytes_pushed);
    MUST(imu.reader.held <= sizeof imu.reader.window);
}

/* What the reader expects changes with the driver's state: the other one is told as well. */
static void follow_header(void) { slow.header_bytes = imu.reader.header_bytes; }

static void push(const uint8_t *bytes, size_t length) {
    size_t taken = 0;
    bool got = true;
    while (taken < length || got) {
        imu_sample_t sample;
        const size_t more = imu_push(&imu, bytes + taken, length - taken, now_us, &sample, &got);
        MUST(more <= length - taken);
        MUST(more > 0 || got || taken == length);
        follow_header();
        slowly(bytes + taken, more);
        taken += more;
        if (got) {
            sound(&sample);
        }
    }
    bytes_pushed += length;
    MUST(imu.counters.frames == frames_seen);
}

static void silence(void) {
    imu_message_t message;
    while (imu_reader_silence(&slow, &message)) {
    }
}

static bool speed_known(uint32_t baud) {
    static const uint32_t bauds[] = {9600,   19200,  38400,  57600, 115200,
                                     128000, 230400, 460800, 921600};
    for (size_t i = 0; i < sizeof bauds / sizeof bauds[0]; i++) {
        if (bauds[i] == baud) {
            return true;
        }
    }
    return false;
}

/* CR and LF may come first, to end what the sensor has got of another line. */
static void keep_command(const imu_action_t *action) {
    const bool after_end = action->length > 2 && memcmp(action->bytes, "\r\n", 2) == 0;
    const char *const line = action->bytes + (after_end ? 2 : 0);
    const uint16_t length = (uint16_t)(action->length - (after_end ? 2u : 0u));
    MUST(length > 6 && length <= IMU_COMMAND_MAX_BYTES && line[0] == '$');
    MUST(imu_line_verify((const uint8_t *)line, length) == IMU_LINE_GOOD);
    memcpy(command, line, length);
    command_bytes = length;
}

static void act(void) {
    uint32_t actions = 0;
    const bool long_silent = now_us - imu.last_byte_us > 20000u;
    for (;;) {
        if (long_silent) {
            silence();
        }
        const imu_action_t action = imu_poll(&imu, 0, now_us);
        if (action.what == IMU_DO_NOTHING) {
            break;
        }
        MUST(++actions < ACTIONS_MAX);
        if (action.what == IMU_DO_SET_BAUD) {
            MUST(speed_known(action.baud));
            silence();
        } else {
            keep_command(&action);
        }
    }
    follow_header();
    MUST(imu.driver.state <= IMU_STREAMING);
    MUST(imu_problem_meaning(imu.driver.problem) != NULL);
    MUST(memchr(imu.driver.model, 0, IMU_NAME_BYTES) != NULL);
    MUST(memchr(imu.driver.firmware, 0, IMU_NAME_BYTES) != NULL);
    if (imu.driver.state == IMU_STREAMING || imu.driver.problem != IMU_PROBLEM_STARTING) {
        problem_since_us = now_us;
    }
    MUST(now_us - problem_since_us <= IMU_DRIVER_VERDICT_US + PASS_US);
}

static void pass(uint32_t passes) {
    for (uint32_t i = 0; i < passes; i++) {
        now_us += PASS_US;
        act();
    }
}

static void raw(input_t *in, size_t most) {
    size_t got = 0;
    const uint8_t *bytes = take_bytes(in, most, &got);
    push(bytes, got);
}

/* A frame of our layout: its clock goes on, its values are the input's. */
static void frame(input_t *in, bool plausible) {
    uint8_t bytes[IMU_FRAME_BYTES] = {0};
    memcpy(bytes, imu_frame_header, IMU_FRAME_HEADER_BYTES);
    take_into(in, bytes + IMU_FRAME_HEADER_BYTES, plausible ? 2 : 56);
    if (plausible) {
        const uint64_t sensor_ns = now_us * 1000u + bytes[7] * 10000u;
        (void)bytes_put_u64(bytes + IMU_FRAME_HEADER_BYTES, sensor_ns);
        (void)bytes_put_f32(bytes + 34, -9.81f);
    }
    const uint16_t crc = crc16(bytes + 1, IMU_FRAME_BYTES - 3u);
    bytes[62] = (uint8_t)(crc >> 8);
    bytes[63] = (uint8_t)(crc & 0xFFu);
    push(bytes, sizeof bytes);
}

/* A line of the input's making, sealed. */
static void any_line(input_t *in) {
    char text[IMU_LINE_MAX_BYTES] = "$VN";
    size_t got = 0;
    const uint8_t kind = take_u8(in);
    const uint8_t *more = take_bytes(in, 16u + kind % 100u, &got);
    uint16_t used = 3;
    for (size_t i = 0; i < got; i++) {
        const char c = (char)(32 + more[i] % 95u);
        text[used++] = c == '$' || c == '*' ? ',' : c;
    }
    used = imu_line_seal(text, used, kind < 128u ? IMU_CHECK_XOR8 : IMU_CHECK_CRC16);
    push((const uint8_t *)text, used);
}

/* What a sensor answers to a setting, or to a question when the input gives the values. */
static void answer(input_t *in, bool with_values) {
    char text[IMU_LINE_MAX_BYTES];
    uint16_t used = 0;
    while (used < command_bytes && command[used] != '*') {
        text[used] = command[used];
        used++;
    }
    if (used < 6) {
        return;
    }
    size_t got = 0;
    const uint8_t *values = take_bytes(in, with_values ? take_u8(in) % 64u : 0, &got);
    for (size_t i = 0; i < got; i++) {
        static const char characters[] = "0123456789,-+.,ABCDEF,0,1,1,8,400";
        text[used++] = characters[values[i] % (sizeof characters - 1u)];
    }
    push((const uint8_t *)text, imu_line_seal(text, used, IMU_CHECK_CRC16));
}

static void step(input_t *in) {
    const uint8_t what = take_u8(in);
    switch (what % 8u) {
    case 0:
        raw(in, 1u + what / 8u);
        break;
    case 1:
        raw(in, CHUNK_BYTES);
        break;
    case 2:
        frame(in, true);
        break;
    case 3:
        frame(in, false);
        break;
    case 4:
        any_line(in);
        break;
    case 5:
        answer(in, what >= 128u);
        break;
    case 6:
        pass(1u + what / 8u);
        break;
    default:
        if (what == 255u) {
            imu_driver_save(&imu.driver);
        }
        act();
        break;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t length) {
    input_t in = {bytes, length};
    const uint8_t choice = take_u8(&in);
    const imu_driver_config_t config = {.baud = 115200,
                                        .rate_hz = choice & 1u ? 50 : 100,
                                        .port = choice / 2u % 3u,
                                        .heading = (int8_t)(choice / 8u % 4u) - 1,
                                        .mount = choice / 32u % 6u};
    now_us = problem_since_us = 1000000u;
    bytes_pushed = frames_seen = command_bytes = 0;
    imu_init(&imu, &config, now_us);
    imu_reader_init(&slow, imu_frame_header, IMU_FRAME_HEADER_BYTES);
    follow_header();
    for (uint32_t i = 0; i < STEPS_MAX && in.left != 0; i++) {
        step(&in);
        alike();
    }
    return 0;
}
