#include "imu/imu.h"

#include "base/units.h"

#include <string.h>

/* Longer than any gap within a message: a sensor's task may interrupt its sending, and so may the
 * pass of the main loop in which we look. */
#define SILENCE_US 20000u
/* 1 us in so many: the offset rises by 100 ppm, faster than crystal (50) and sensor (20) drift
 * apart. */
#define RISE_DIVISOR 10000u
/* No pause of the main loop explains a frame that is so late: the clocks have parted. */
#define LATE_MAX_US 500000

static void follow_clock(imu_t *imu, uint64_t sensor_us, uint64_t now_us, bool anew) {
    const int64_t late_us = (int64_t)(now_us - sensor_us) - imu->offset_us;
    const uint32_t rise_us = (uint32_t)(now_us - imu->offset_at_us) / RISE_DIVISOR;
    if (anew || late_us < (int64_t)rise_us || late_us > LATE_MAX_US) {
        imu->offset_us += late_us;
        imu->offset_at_us = now_us;
    } else {
        imu->offset_us += rise_us;
        imu->offset_at_us += rise_us * RISE_DIVISOR;
    }
}

/* Whether it is good. */
static bool take_frame(imu_t *imu, const uint8_t *bytes, uint64_t now_us, imu_sample_t *sample) {
    if (!imu_frame_decode(bytes, &sample->frame)) {
        imu->counters.implausible++;
        imu_driver_frame(&imu->driver, false, now_us);
        return false;
    }
    /* Until it is set up it may send at another rate. */
    const bool set_up = imu->driver.state == IMU_STREAMING;
    imu->sequence.nominal_ns = set_up ? 1000000000u / imu->driver.config.rate_hz : 0;
    const uint64_t sensor_ns = sample->frame.time_startup_ns;
    sample->step = imu_sequence_next(&imu->sequence, sensor_ns, &sample->dt_s);
    const bool restart = sample->step == IMU_STEP_RESTART;
    const uint64_t sensor_us = units_thousandth(sensor_ns);
    follow_clock(imu, sensor_us, now_us, restart || sample->step == IMU_STEP_FIRST);
    sample->time_us = sensor_us + (uint64_t)imu->offset_us;
    imu->counters.frames++;
    imu->last = sample->frame;
    imu->last_us = now_us;
    imu_driver_frame(&imu->driver, restart, now_us);
    return true;
}

static bool is_ours(const imu_message_t *message) {
    return message->kind == IMU_BINARY &&
           memcmp(message->bytes, imu_frame_header, IMU_FRAME_HEADER_BYTES) == 0;
}

/* What a half message hid: no frame, for it could not be handed out; it will be counted as lost. */
static void give_up_held(imu_t *imu, uint64_t now_us) {
    imu_message_t message;
    while (imu_reader_silence(&imu->reader, &message)) {
        if (!is_ours(&message)) {
            imu_driver_message(&imu->driver, &message, now_us);
        }
    }
}

/* Another layout tells that the sensor sends, which matters only as long as it is looked for. */
static void expect_header(imu_t *imu) {
    imu->reader.header_bytes = imu->driver.state == IMU_SEARCHING ? 0 : IMU_FRAME_HEADER_BYTES;
}

static void judge_span(imu_t *imu, uint32_t overruns) {
    const imu_reader_counters_t *reader = &imu->reader.counters;
    const uint32_t counts[] = {
        reader->crc_failed + reader->checksum_failed,
        reader->skipped_bytes,
        imu->sequence.lost,
        overruns,
        imu->sequence.restarts,
        imu->counters.implausible,
    };
    imu->health = 0;
    for (unsigned bit = 0; bit < sizeof counts / sizeof counts[0]; bit++) {
        imu->health = (uint16_t)(imu->health | (counts[bit] != imu->health_base[bit]) << bit);
        imu->health_base[bit] = counts[bit];
    }
}

static void judge(imu_t *imu, uint32_t overruns, uint64_t now_us) {
    if (now_us - imu->health_at_us >= IMU_HEALTH_SPAN_US) {
        imu->health_at_us = now_us;
        judge_span(imu, overruns);
    }
    const uint64_t patience_us = imu_driver_patience_us(&imu->driver.config);
    const bool silent = imu->last_us == 0 || now_us - imu->last_us > patience_us;
    const bool set_up = imu->driver.state == IMU_STREAMING;
    imu->health &= (uint16_t) ~(IMU_HEALTH_SILENT | IMU_HEALTH_NOT_SET_UP);
    imu->health = (uint16_t)(imu->health | (silent ? IMU_HEALTH_SILENT : 0) |
                             (set_up ? 0 : IMU_HEALTH_NOT_SET_UP));
}

void imu_init(imu_t *imu, const imu_driver_config_t *config, uint64_t now_us) {
    memset(imu, 0, sizeof *imu);
    imu->health_at_us = now_us;
    imu->health = IMU_HEALTH_SILENT | IMU_HEALTH_NOT_SET_UP;
    imu_reader_init(&imu->reader, imu_frame_header, IMU_FRAME_HEADER_BYTES);
    imu_configure(imu, config, now_us);
}

void imu_configure(imu_t *imu, const imu_driver_config_t *config, uint64_t now_us) {
    imu_driver_init(&imu->driver, config, now_us);
    expect_header(imu);
}

size_t imu_push(imu_t *imu, const uint8_t *bytes, size_t length, uint64_t now_us,
                imu_sample_t *sample, bool *got) {
    size_t taken = 0;
    bool message_got = true;
    *got = false;
    while (!*got && (taken < length || message_got)) {
        imu_message_t message;
        taken +=
            imu_reader_push(&imu->reader, bytes + taken, length - taken, &message, &message_got);
        if (message_got && is_ours(&message)) {
            *got = take_frame(imu, message.bytes, now_us, sample);
        } else if (message_got) {
            imu_driver_message(&imu->driver, &message, now_us);
        }
    }
    if (taken != 0) {
        imu->last_byte_us = now_us;
        imu_driver_bytes(&imu->driver, (uint32_t)taken);
    }
    expect_header(imu);
    return taken;
}

imu_action_t imu_poll(imu_t *imu, uint32_t overruns, uint64_t now_us) {
    if (now_us - imu->last_byte_us > SILENCE_US) {
        give_up_held(imu, now_us);
    }
    const imu_action_t action = imu_driver_poll(&imu->driver, now_us);
    if (action.what == IMU_DO_SET_BAUD) {
        give_up_held(imu, now_us);
    }
    expect_header(imu);
    judge(imu, overruns, now_us);
    return action;
}
