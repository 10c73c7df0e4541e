#include "imu/frame.h"

#include <float.h>
#include <stddef.h>
#include <string.h>

enum { OFFSET_TIME = 6, OFFSET_VALUES = 14, WORD_BYTES = 4, VALUES = 12, VECTOR = 3 };

#define SIZE_BITS 0x7FFFFFFFu

const uint8_t imu_frame_header[IMU_FRAME_HEADER_BYTES] = {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00};

static uint32_t load_u32(const uint8_t *bytes) {
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 |
           (uint32_t)bytes[3] << 24;
}

/* What each value's size may be; the largest number there is: any that is finite. */
static const float most[VALUES] = {
    FLT_MAX,
    IMU_PITCH_MAX_DEG,
    FLT_MAX,
    IMU_RATE_MAX_RAD_S,
    IMU_RATE_MAX_RAD_S,
    IMU_RATE_MAX_RAD_S,
    IMU_ACCEL_MAX_M_S2,
    IMU_ACCEL_MAX_M_S2,
    IMU_ACCEL_MAX_M_S2,
    IMU_LINEAR_ACCEL_MAX_M_S2,
    IMU_LINEAR_ACCEL_MAX_M_S2,
    IMU_LINEAR_ACCEL_MAX_M_S2,
};

/* Sizes of floats are in the order of their bits, infinity and NaN above all numbers. */
bool imu_frame_decode(const uint8_t *bytes, imu_frame_t *frame) {
    uint32_t values[VALUES], limits[VALUES], beyond = 0;
    memcpy(limits, most, sizeof limits);
    for (size_t i = 0; i < VALUES; i++) {
        values[i] = load_u32(bytes + OFFSET_VALUES + WORD_BYTES * i);
        beyond |= limits[i] - (values[i] & SIZE_BITS);
    }
    frame->time_startup_ns = (uint64_t)load_u32(bytes + OFFSET_TIME) |
                             (uint64_t)load_u32(bytes + OFFSET_TIME + WORD_BYTES) << 32;
    memcpy(frame->ypr_deg, values, sizeof frame->ypr_deg);
    memcpy(frame->rate_rad_s, values + VECTOR, sizeof frame->rate_rad_s);
    memcpy(frame->accel_m_s2, values + 2 * VECTOR, sizeof frame->accel_m_s2);
    memcpy(frame->linear_accel_m_s2, values + 3 * VECTOR, sizeof frame->linear_accel_m_s2);
    return beyond <= SIZE_BITS; /* no difference was below zero */
}

void imu_sequence_init(imu_sequence_t *sequence, uint32_t nominal_ns) {
    *sequence = (imu_sequence_t){.nominal_ns = nominal_ns};
}

/* Both steps lose the same low bits until the longer one fits: no 64-bit division. */
typedef struct {
    uint32_t step, nominal;
    float unit_s;
} scaled_t;

static scaled_t scale(uint64_t step_ns, uint32_t nominal_ns) {
    scaled_t scaled = {.nominal = nominal_ns, .unit_s = 1e-9f};
    while (step_ns > UINT32_MAX) {
        step_ns >>= 1;
        scaled.nominal = scaled.nominal >> 1 | 1u;
        scaled.unit_s *= 2.0f;
    }
    scaled.step = (uint32_t)step_ns;
    return scaled;
}

static uint32_t steps_rounded(uint32_t step, uint32_t nominal) {
    const uint32_t rest = step % nominal;
    return step / nominal + (rest > nominal / 2u ? 1u : 0u);
}

imu_step_t imu_sequence_next(imu_sequence_t *sequence, uint64_t time_ns, float *dt_s) {
    const bool first = !sequence->any;
    const bool rises = time_ns > sequence->last_ns;
    const scaled_t scaled = scale(time_ns - sequence->last_ns, sequence->nominal_ns);
    sequence->last_ns = time_ns;
    sequence->any = true;
    *dt_s = 0.0f;
    if (first) {
        return IMU_STEP_FIRST;
    }
    if (!rises) {
        sequence->restarts++;
        return IMU_STEP_RESTART;
    }
    *dt_s = (float)scaled.step * scaled.unit_s;
    const uint32_t steps =
        sequence->nominal_ns == 0 ? 1u : steps_rounded(scaled.step, scaled.nominal);
    if (steps <= 1) {
        return IMU_STEP_NEXT;
    }
    sequence->lost += steps - 1u;
    return IMU_STEP_GAP;
}
