#include "vn100_stream.h"

#include "noise.h"

#include <math.h>
#include <string.h>

#define DEG (3.14159265358979323846 / 180)
#define G_M_S2 9.793746 /* the sensor's factory gravity, register 21 */
#define START_US 200000u
#define TCXO 12e-6 /* its clock runs fast by this; specified within 20 ppm */
/* One frame of the servo: the plant is known up to one frame ago. */
#define LAG_US 20000u
#define YAW_PER_TAIL (-10.0 / 45.0)
#define ROLL_PER_TAIL 0.03
#define PITCH_PER_TAIL2 0.02

void vn100_init(vn100_t *vn100, const sim_config_t *config) {
    vn100->seed = config->seed;
    vn100->rate_hz = config->imu_rate_hz;
    vn100->noise = config->imu_noise;
    vn100->plugged = true;
    /* White noise averaged over the whole period between two frames (register 85). */
    const double root_bandwidth = sqrt(config->imu_rate_hz / 2) * config->imu_noise;
    vn100->accel_sigma_m_s2 = 0.14e-3 * G_M_S2 * root_bandwidth;
    vn100->rate_sigma_rad_s = 0.0035 * DEG * root_bandwidth;
}

void vn100_power_on(vn100_t *vn100, uint64_t now_us) {
    vn100->powered = true;
    vn100->power_us = now_us;
    vn100->sample = 0;
    vn100->key = noise_key(vn100->seed, NOISE_IMU, vn100->starts);
    /* Constant of the unit: 5 mg, a measured one was 16 mg off. New at every start: 0.04 mg, 7
     * deg/h, 0.5 deg of pitch and roll, 2 deg of heading. */
    const uint64_t unit = noise_key(vn100->seed, NOISE_IMU_BIAS, UINT32_MAX);
    const uint64_t run = noise_key(vn100->seed, NOISE_IMU_BIAS, vn100->starts);
    for (unsigned i = 0; i < 3; i++) {
        vn100->accel_bias_m_s2[i] = vn100->noise * 1e-3 * G_M_S2 *
                                    (5 * noise_normal(unit, i) + 0.04 * noise_normal(run, i));
        vn100->rate_bias_rad_s[i] = vn100->noise * 7.0 / 3600 * DEG * noise_normal(run, 3 + i);
        vn100->attitude_bias_deg[i] =
            vn100->noise * (i == 0 ? 2.0 : 0.5) * noise_normal(run, 6 + i);
    }
    vn100->starts++;
}

void vn100_power_off(vn100_t *vn100) { vn100->powered = false; }

uint64_t vn100_due_us(const vn100_t *vn100) {
    if (!vn100->plugged || !vn100->powered || vn100->rate_hz <= 0) {
        return UINT64_MAX;
    }
    const double since = (double)vn100->sample * 1e6 / vn100->rate_hz;
    return vn100->power_us + START_US + (uint64_t)since;
}

static uint8_t *put_u64(uint8_t *at, uint64_t value) {
    for (unsigned i = 0; i < 8; i++) {
        at[i] = (uint8_t)(value >> (8 * i));
    }
    return at + 8;
}

static uint8_t *put_f32(uint8_t *at, double value) {
    const float single = (float)value;
    uint32_t word;
    memcpy(&word, &single, sizeof word);
    for (unsigned i = 0; i < 4; i++) {
        at[i] = (uint8_t)(word >> (8 * i));
    }
    return at + 4;
}

/* CRC-16/XMODEM, written apart from the firmware's so that neither can hide the other's mistake. */
static uint16_t crc_xmodem(const uint8_t *bytes, size_t length) {
    uint32_t crc = 0;
    for (size_t i = 0; i < length; i++) {
        uint32_t x = ((crc >> 8) ^ bytes[i]) & 0xFFu;
        x ^= x >> 4;
        crc = ((crc << 8) ^ (x << 12) ^ (x << 5) ^ x) & 0xFFFFu;
    }
    return (uint16_t)crc;
}

typedef struct {
    double yaw_deg, pitch, roll;
    double rate_rad_s[3], linear_m_s2[3], accel_m_s2[3];
} motion_t;

static motion_t motion_of(const vn100_t *vn100, const fish_moment_t *now) {
    const double tail = now->tail_rad;
    motion_t m = {
        .yaw_deg = YAW_PER_TAIL * tail / DEG,
        .pitch = PITCH_PER_TAIL2 * tail * tail,
        .roll = vn100->tilt_rad + ROLL_PER_TAIL * tail,
        .rate_rad_s = {ROLL_PER_TAIL * now->tail_rate_rad_s,
                       2 * PITCH_PER_TAIL2 * tail * now->tail_rate_rad_s,
                       YAW_PER_TAIL * now->tail_rate_rad_s},
    };
    const double yaw = YAW_PER_TAIL * tail;
    m.linear_m_s2[0] = now->accel_m_s2 * cos(yaw);
    m.linear_m_s2[1] = -now->accel_m_s2 * sin(yaw);
    const double level = G_M_S2 * cos(m.pitch);
    m.accel_m_s2[0] = m.linear_m_s2[0] + G_M_S2 * sin(m.pitch);
    m.accel_m_s2[1] = m.linear_m_s2[1] - level * sin(m.roll);
    m.accel_m_s2[2] = m.linear_m_s2[2] - level * cos(m.roll);
    return m;
}

static void add_noise(const vn100_t *vn100, motion_t *m) {
    const uint64_t first = vn100->sample * 8;
    for (unsigned i = 0; i < 3; i++) {
        const double a = vn100->accel_sigma_m_s2 * noise_normal(vn100->key, first + i);
        m->accel_m_s2[i] += a + vn100->accel_bias_m_s2[i];
        /* The sensor's own attitude filter takes a constant bias for gravity. */
        m->linear_m_s2[i] += a;
        m->rate_rad_s[i] += vn100->rate_bias_rad_s[i] +
                            vn100->rate_sigma_rad_s * noise_normal(vn100->key, first + 3 + i);
    }
}

/* Whole microseconds with +-10 us of jitter, as measured on real sensors. */
static uint64_t sensor_clock_ns(const vn100_t *vn100) {
    const double since_us = (double)(vn100_due_us(vn100) - vn100->power_us) * (1 + TCXO);
    const double jitter =
        vn100->noise > 0 ? 20 * noise_uniform(vn100->key, vn100->sample * 8 + 6) - 10 : 0;
    return (uint64_t)(since_us + jitter) * 1000u;
}

static double wrapped_deg(double angle) {
    return angle > 180 ? angle - 360 : angle < -180 ? angle + 360 : angle;
}

void vn100_frame(vn100_t *vn100, const fish_t *fish, uint8_t out[VN100_FRAME_BYTES]) {
    static const uint8_t header[6] = {0xFA, 0x11, 0x29, 0x01, 0x40, 0x00};
    const uint64_t due_us = vn100_due_us(vn100);
    const fish_moment_t now = fish_at(fish, due_us > LAG_US ? due_us - LAG_US : 0);
    motion_t m = motion_of(vn100, &now);
    if (vn100->noise > 0) {
        add_noise(vn100, &m);
    }
    memcpy(out, header, sizeof header);
    uint8_t *at = put_u64(out + sizeof header, sensor_clock_ns(vn100));
    at = put_f32(at, wrapped_deg(m.yaw_deg + vn100->attitude_bias_deg[0]));
    at = put_f32(at, m.pitch / DEG + vn100->attitude_bias_deg[1]);
    at = put_f32(at, wrapped_deg(m.roll / DEG + vn100->attitude_bias_deg[2]));
    for (unsigned i = 0; i < 3; i++) {
        at = put_f32(at, m.rate_rad_s[i]);
    }
    for (unsigned i = 0; i < 3; i++) {
        at = put_f32(at, m.accel_m_s2[i]);
    }
    for (unsigned i = 0; i < 3; i++) {
        at = put_f32(at, m.linear_m_s2[i]);
    }
    const uint16_t crc = crc_xmodem(out + 1, VN100_FRAME_BYTES - 3);
    at[0] = (uint8_t)(crc >> 8);
    at[1] = (uint8_t)crc;
    vn100->sample++;
}
