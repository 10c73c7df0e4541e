#include "imu/imu.h"

#include "base/crc.h"
#include "base/real.h"

#include <string.h>

enum {
    OFFSET_TIME = 6,
    OFFSET_YPR = 14,
    OFFSET_RATE = 26,
    OFFSET_ACCEL = 38,
    OFFSET_LINEAR_ACCEL = 50,
};

static const uint8_t HEADER[] = {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00};

static size_t smaller(size_t a, size_t b) { return a < b ? a : b; }

static uint32_t load_u32(const uint8_t *bytes) {
    return (uint32_t)bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 |
           (uint32_t)bytes[3] << 24;
}

static void load_vector(float out[3], const uint8_t *bytes) {
    for (size_t axis = 0; axis < 3; axis++) {
        const uint32_t bits = load_u32(bytes + 4 * axis);
        memcpy(&out[axis], &bits, sizeof bits);
    }
}

static imu_frame_t parse(const uint8_t *window) {
    imu_frame_t frame;
    frame.time_startup_ns = (uint64_t)load_u32(window + OFFSET_TIME) |
                            (uint64_t)load_u32(window + OFFSET_TIME + 4) << 32;
    load_vector(frame.ypr_deg, window + OFFSET_YPR);
    load_vector(frame.rate_rad_s, window + OFFSET_RATE);
    load_vector(frame.accel_m_s2, window + OFFSET_ACCEL);
    load_vector(frame.linear_accel_m_s2, window + OFFSET_LINEAR_ACCEL);
    return frame;
}

/* False for NaN too. */
static bool all_within(const float v[3], float limit) {
    return real_abs(v[0]) <= limit && real_abs(v[1]) <= limit && real_abs(v[2]) <= limit;
}

static bool values_plausible(const imu_frame_t *frame) {
    return real_is_finite(frame->ypr_deg[0]) && real_abs(frame->ypr_deg[1]) <= IMU_PITCH_MAX_DEG &&
           real_is_finite(frame->ypr_deg[2]) && all_within(frame->rate_rad_s, IMU_RATE_MAX_RAD_S) &&
           all_within(frame->accel_m_s2, IMU_ACCEL_MAX_M_S2) &&
           all_within(frame->linear_accel_m_s2, IMU_LINEAR_ACCEL_MAX_M_S2);
}

/* Takes over the frame's time whatever it is, so that a restarted sensor costs one frame. */
static bool time_rises(imu_t *imu, uint64_t time_ns) {
    const bool first = imu->counters.frames == 0 && imu->counters.implausible == 0;
    const bool rises = first || time_ns > imu->last_time_ns;
    imu->last_time_ns = time_ns;
    return rises;
}

static bool header_fits(const imu_t *imu) {
    return memcmp(imu->window, HEADER, smaller(imu->held, sizeof HEADER)) == 0;
}

/* Drops the window's first byte and all up to the next place where a frame may begin. */
static void search_on(imu_t *imu) {
    do {
        const uint8_t *rest = imu->window + 1;
        const size_t length = imu->held - 1u;
        const uint8_t *sync = memchr(rest, HEADER[0], length);
        const size_t kept = sync == NULL ? 0 : length - (size_t)(sync - rest);
        imu->counters.skipped_bytes += (uint32_t)(imu->held - kept);
        if (kept != 0) {
            memmove(imu->window, sync, kept);
        }
        imu->held = (uint8_t)kept;
    } while (!header_fits(imu));
}

/* How many bytes come before the next sync byte. */
static size_t skip_to_sync(imu_t *imu, const uint8_t *bytes, size_t length) {
    const uint8_t *sync = memchr(bytes, HEADER[0], length);
    const size_t skipped = sync == NULL ? length : (size_t)(sync - bytes);
    imu->counters.skipped_bytes += (uint32_t)skipped;
    return skipped;
}

/* Judges a full window. Returns whether it was a good frame. */
static bool finish_frame(imu_t *imu, imu_frame_t *frame) {
    if (crc16_update(0, imu->window + 1, IMU_FRAME_BYTES - 1u) != 0) {
        imu->counters.crc_failed++;
        search_on(imu);
        return false;
    }
    imu->held = 0;
    const imu_frame_t parsed = parse(imu->window);
    const bool rises = time_rises(imu, parsed.time_startup_ns);
    if (!rises || !values_plausible(&parsed)) {
        imu->counters.implausible++;
        return false;
    }
    imu->counters.frames++;
    *frame = parsed;
    return true;
}

void imu_init(imu_t *imu) { memset(imu, 0, sizeof *imu); }

size_t imu_push(imu_t *imu, const uint8_t *bytes, size_t length, imu_frame_t *frame, bool *got) {
    size_t taken = 0;
    *got = false;
    while (taken < length && !*got) {
        if (imu->held == 0) {
            taken += skip_to_sync(imu, bytes + taken, length - taken);
        }
        const size_t chunk = smaller(IMU_FRAME_BYTES - imu->held, length - taken);
        memcpy(imu->window + imu->held, bytes + taken, chunk);
        imu->held = (uint8_t)(imu->held + chunk);
        taken += chunk;
        if (!header_fits(imu)) {
            search_on(imu);
        } else if (imu->held == IMU_FRAME_BYTES) {
            *got = finish_frame(imu, frame);
        }
    }
    return taken;
}
