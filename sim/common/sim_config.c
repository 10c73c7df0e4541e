#include "sim_config.h"

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
