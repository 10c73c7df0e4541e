#include "config_valid.h"

#include "sensor/vn100.h"
#include "water/plant.h"
#include "water/tail_beat.h"

static bool within(double x, double low, double high) { return x >= low && x <= high; }

/* A fish is neither caught nor put back before its swim is over. */
static bool never_or_later(double after_s) {
    return within(after_s, 0.2, 1e5) || within(after_s, 0, 0);
}

static bool water_valid(const sim_config_t *c) {
    return plant_config_valid(c) && tail_beat_frames(c->beat_s) != 0 &&
           within(c->gain_sigma, 0, 1) && within(c->flow_sigma_m_s, 0, 10) &&
           within(c->start_sigma_m_s, 0, 10) && within(c->flow_moves_m_s, 0, 10) &&
           within(c->standing_wave_m_s, 0, 10) && within(c->drift_sigma, 0, 1) &&
           within(c->drift_trend, -1, 1) && within(c->outliers, 0, 1) &&
           within(c->place_sigma_m, 0, 1) && within(c->place_sigma_rad, 0, 1) &&
           within(c->lost_beats, 0, 1) && never_or_later(c->caught_after_s) &&
           never_or_later(c->placed_after_s);
}

static bool camera_valid(const sim_config_t *c) {
    return within(c->camera_noise_m, 0, 10) && within(c->camera_lost, 0, 1) &&
           within(c->camera_fps, 0, 1000) && within(c->camera_exposure_s, 0, 1) &&
           within(c->camera_latency_s, 0.02, 10);
}

static bool imu_valid(const sim_config_t *c) {
    const bool firmware = c->imu_firmware == 0 || c->imu_firmware == 2 || c->imu_firmware == 3;
    return within(c->imu_noise, 0, 1e3) && within(c->imu_bias_mg, 0, 1e3) &&
           within(c->imu_accel_scale, 0, 0.1) && within(c->imu_rate_scale, 0, 0.1) &&
           within(c->imu_misaligned_rad, 0, 0.1) && within(c->roll_per_tail, -1, 1) &&
           within(c->roll_lag_rad, -4, 4) && within(c->cone_per_tail, -1, 1) &&
           within(c->tremor_rad, 0, 0.1) && firmware && (c->imu_port == 1 || c->imu_port == 2) &&
           vn100_baud_valid(c->imu_baud) && within(c->imu_bit_errors, 0, 1) &&
           within(c->imu_lost_bytes, 0, 1);
}

/* A link of 0 bytes per second is not limited. */
static bool electronics_valid(const sim_config_t *c) {
    return within(c->battery_v, 0, 60) && within(c->battery_sag_v_per_trial, 0, 60) &&
           within(c->battery_load_v, 0, 60) && within(c->boot_s, 0, 1e5) &&
           (within(c->link_bytes_per_s, 10, 1e9) || within(c->link_bytes_per_s, 0, 0));
}

bool sim_config_valid(const sim_config_t *c) {
    return water_valid(c) && camera_valid(c) && imu_valid(c) && electronics_valid(c);
}
