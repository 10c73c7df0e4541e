/*
 * The VN-100's binary frames (groups 0x11, Common 0x0129, Attitude 0x0040; user manual UM001), as
 * it would see the swimming fish: yaw +-10 degrees with the tail, a little roll and pitch, with the
 * specified noise of 0.14 mg/sqrt(Hz) and 0.0035 deg/s/sqrt(Hz).
 */
#ifndef SIM_VN100_STREAM_H
#define SIM_VN100_STREAM_H

#include "fish.h"

#define VN100_FRAME_BYTES 64u

typedef struct {
    uint64_t seed;
    double rate_hz, noise;
    bool plugged, powered;
    uint64_t power_us; /* simulated time at which its clock started */
    uint64_t starts;   /* times it was powered */
    uint64_t sample;   /* next frame since start-up */
    uint64_t key;
    double tilt_rad;
    double accel_bias_m_s2[3], rate_bias_rad_s[3], attitude_bias_deg[3];
    double accel_sigma_m_s2, rate_sigma_rad_s;
} vn100_t;

void vn100_init(vn100_t *vn100, const sim_config_t *config);
void vn100_power_on(vn100_t *vn100, uint64_t now_us);
void vn100_power_off(vn100_t *vn100);

/* Simulated time of the next frame; UINT64_MAX = none. */
uint64_t vn100_due_us(const vn100_t *vn100);
void vn100_frame(vn100_t *vn100, const fish_t *fish, uint8_t out[VN100_FRAME_BYTES]);

#endif
