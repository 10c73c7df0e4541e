#include "settings/settings.h"

/* The tick is crystal-driven: a gap of a quarter frame beyond the period can only be a stall. */
#define TICK_LATE_US (FRAME_US + FRAME_US / 4u)
#define IMU_NEEDED_TIMEOUT_S 1.0f

/* Values of ILC_KIND after those of past_kind_t. */
#define ILC_KIND_ADAPTIVE 3.0f
#define ILC_KIND_ROBUST 4.0f
#define ILC_KIND_SIGN 5.0f

static uint32_t microseconds(float seconds) { return (uint32_t)(seconds * 1e6f + 0.5f); }

static uint16_t millivolts(float volts) { return (uint16_t)(volts * 1000.0f + 0.5f); }

uint16_t settings_frames(float seconds) { return (uint16_t)(seconds / FRAME_S + 0.5f); }

law_t settings_law(const params_t *params, float beat_s) {
    return (law_t){
        .kp_rad_s_m = params->value[PARAM_ILC_GAIN],
        .kd_rad_s2_m = params->value[PARAM_ILC_KD],
        .amplitude_max_rad = params->value[PARAM_AMP_MAX_RAD],
        .step_max_rad = params->value[PARAM_DU_MAX_RAD],
        .beat_s = beat_s,
        .lead_beats = params->value[PARAM_ILC_LEAD],
        .fade = params->value[PARAM_ILC_DECR_RATE],
        .fade_from = (uint16_t)params_whole(params, PARAM_ILC_DECR_FROM),
        .q_len = (uint16_t)params_whole(params, PARAM_ILC_Q_LEN),
        .tail = (law_tail_t)params_whole(params, PARAM_ILC_END_EXT),
    };
}

memory_rules_t settings_memory_rules(const params_t *params) {
    return (memory_rules_t){
        .rollback_ratio = params->value[PARAM_ROLLBACK_RATIO],
        .beyond = (beyond_t)params_whole(params, PARAM_ILC_EXTRAP),
    };
}

past_kind_t settings_past_kind(const params_t *params) {
    return (past_kind_t)params_whole(params, PARAM_ILC_KIND);
}

uint16_t settings_past_window(const params_t *params) {
    return (uint16_t)params_whole(params, PARAM_ILC_WINDOW);
}

bool settings_law_fits(const params_t *params, const law_t *law, uint16_t beats) {
    return law_check(law, beats) == LAW_OK && past_fits(settings_past_kind(params), law);
}

/* These laws correct while the plant moves (ilc/feedback.h). */
fault_t settings_refusal(param_t param, float value) {
    if (param != PARAM_ILC_KIND) {
        return FAULT_NONE;
    }
    if (value == ILC_KIND_ADAPTIVE || value == ILC_KIND_ROBUST) {
        return FAULT_LAW_FEEDBACK;
    }
    return value == ILC_KIND_SIGN ? FAULT_LAW_SIGN : FAULT_NONE;
}

gait_config_t settings_gait(const params_t *params, float beat_s) {
    return (gait_config_t){
        .servo =
            {
                .centre_us = params->value[PARAM_SERVO_CENTRE_US],
                .us_per_rad = params->value[PARAM_SERVO_US_RAD],
                .min_us = params->value[PARAM_SERVO_MIN_US],
                .max_us = params->value[PARAM_SERVO_MAX_US],
                .direction = params->value[PARAM_SERVO_DIR],
                .slew_rad_s = params->value[PARAM_SERVO_SLEW_RAD_S],
            },
        .frames_per_beat = settings_frames(beat_s),
        .coast_frames = settings_frames(params->value[PARAM_COAST_S]),
    };
}

/* A camera fits its line over a whole beat at least: part of one would be another speed. */
static float vision_window_s(const params_t *params, float beat_s) {
    const float window_s = params->value[PARAM_SPD_WINDOW_S];
    return window_s > 0.0f && window_s < beat_s ? beat_s : window_s;
}

speed_source_t settings_source(const params_t *params) {
    return (speed_source_t)params_whole(params, PARAM_SPD_SOURCE);
}

estimate_config_t settings_estimate(const params_t *params, float beat_s, uint16_t beats) {
    return (estimate_config_t){
        .source = settings_source(params),
        .beat_s = beat_s,
        .beats = beats,
        .vision =
            {
                .window_s = vision_window_s(params, beat_s),
                .gap_max_s = params->value[PARAM_SPD_GAP_S],
                .plausible_m_s = params->value[PARAM_SPD_PLAUS_M_S],
            },
        .thrust =
            {
                .kappa_per_m = params->value[PARAM_MDL_KAPPA],
                .slope_m_s_rad = params->value[PARAM_MDL_SLOPE],
                .dead_zone_rad = params->value[PARAM_MDL_DEAD_RAD],
                .delay_s = params->value[PARAM_MDL_DELAY_S],
            },
        .model_sigma = params->value[PARAM_MDL_SIGMA],
        .rest_sigma_m_s = params->value[PARAM_REST_SIGMA_M_S],
        .rest_min_s = params->value[PARAM_REST_MIN_S],
        .sigma_max_m_s = params->value[PARAM_SPD_SIGMA_MAX],
    };
}

imu_driver_config_t settings_imu(const params_t *params) {
    return (imu_driver_config_t){
        .baud = (uint32_t)params_whole(params, PARAM_IMU_BAUD),
        .rate_hz = (uint16_t)params_whole(params, PARAM_IMU_RATE_HZ),
        .port = (uint8_t)params_whole(params, PARAM_IMU_PORT),
        .heading = (int8_t)params_whole(params, PARAM_IMU_HEADING),
        .mount = (uint8_t)params_whole(params, PARAM_IMU_MOUNT),
    };
}

bool settings_need_imu(const params_t *params) {
    return speed_source_is(settings_source(params), SPEED_NEEDS_IMU);
}

static float imu_timeout_s(const params_t *params) {
    const float wanted_s = params->value[PARAM_IMU_TIMEOUT_S];
    return settings_need_imu(params) && wanted_s <= 0.0f ? IMU_NEEDED_TIMEOUT_S : wanted_s;
}

stop_limits_t settings_stop_limits(const params_t *params) {
    return (stop_limits_t){
        .link_timeout_us = microseconds(params->value[PARAM_LINK_TIMEOUT_S]),
        .imu_timeout_us = microseconds(imu_timeout_s(params)),
        .tick_late_us = TICK_LATE_US,
        .battery_sag_us = microseconds(params->value[PARAM_BATT_SAG_S]),
        .battery_critical_mv = millivolts(params->value[PARAM_BATT_CRIT_V]),
        .tilt_max_rad = params->value[PARAM_TILT_MAX_RAD],
    };
}

battery_voltage_t settings_battery(const params_t *params, uint16_t reading) {
    return battery_voltage(reading, params->value[PARAM_BATT_ADC_V],
                           params->value[PARAM_BATT_DIVIDER]);
}

uint16_t settings_battery_low_mv(const params_t *params) {
    return millivolts(params->value[PARAM_BATT_LOW_V]);
}
