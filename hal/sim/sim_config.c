#include "sim_config.h"

#include "plant.h"
#include "tail.h"
#include "vn100.h"

void sim_config_default(sim_config_t *config, sim_plant_t plant) {
    *config = (sim_config_t){
        .seed = 1,
        .plant = plant,
        .mass_kg = 0.4,
        .body_length_m = 0.36,
        .water_density_kg_m3 = 1000,
        .tail_area_m2 = 3.14159265358979323846 * 0.165 * 0.165 / 4,
        .drag_kg_m = 165.7056,
        .kappa_per_m = 10,
        .delay_s = 0.3,
        .slope_m_s_rad = 0.219,
        .dead_zone_rad = 0.197,
        .servo_lag_s = 0.04,
        .servo_rate_rad_s = 5.23598775598298873,
        .fin_depth_m = 0.08,
        .thrust_exponent = 2,
        .beat_s = 1,
        .camera_fps = 25,
        .camera_exposure_s = 0.01,
        .camera_latency_s = 0.08,
        .caught_after_s = 1,
        .placed_after_s = 5,
        .imu_bias_mg = 5,
        .roll_per_tail = 0.03,
        .imu_firmware = 3,
        .imu_baud = 115200,
        .imu_port = 2,
        .battery_v = 8.2,
        .link_bytes_per_s = 11520,
        .boot_s = 1.7,
    };
    if (plant == SIM_PLANT_REACTIVE) {
        config->mass_kg = 1.3;
        config->servo_backlash_rad = 0.03;
        config->wake_share = 0.1;
        config->wake_s = 0.8;
        config->delay_s = 0.1;
    }
    if (plant != SIM_PLANT_THESIS) {
        config->gain_sigma = 0.02;
        config->flow_sigma_m_s = 0.0015;
        config->start_sigma_m_s = 0.002;
        config->place_sigma_m = 0.005;
        config->place_sigma_rad = 0.0174532925199432958;
        config->camera_noise_m = 0.001;
        config->imu_noise = 1;
    }
}

static bool within(double x, double low, double high) { return x >= low && x <= high; }

/* A fish is neither caught nor put back before its swim is over. */
static bool never_or_later(double after_s) {
    return within(after_s, 0.2, 1e5) || within(after_s, 0, 0);
}

static bool water_valid(const sim_config_t *c) {
    return plant_config_valid(c) && tail_frames(c->beat_s) != 0 && within(c->gain_sigma, 0, 1) &&
           within(c->flow_sigma_m_s, 0, 10) && within(c->start_sigma_m_s, 0, 10) &&
           within(c->flow_moves_m_s, 0, 10) && within(c->standing_wave_m_s, 0, 10) &&
           within(c->drift_sigma, 0, 1) && within(c->drift_trend, -1, 1) &&
           within(c->outliers, 0, 1) && within(c->place_sigma_m, 0, 1) &&
           within(c->place_sigma_rad, 0, 1) && within(c->lost_beats, 0, 1) &&
           never_or_later(c->caught_after_s) && never_or_later(c->placed_after_s);
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
