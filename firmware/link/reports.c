#include "link/reports.h"

#include "base/real.h"

#include <math.h>
#include <string.h>

static uint8_t system_status(state_t state) {
    switch (state) {
    case STATE_BOOT:
        return MAV_STATE_BOOT;
    case STATE_ARMED:
    case STATE_RUNNING:
        return MAV_STATE_ACTIVE;
    case STATE_ABORTED:
    case STATE_FAULT:
        return MAV_STATE_CRITICAL;
    case STATE_IDLE:
    case STATE_SETTLING:
    case STATE_LEARNING:
    case STATE_COUNT:
    default:
        return MAV_STATE_STANDBY;
    }
}

void reports_heartbeat(const reports_t *reports, channel_t *channel) {
    const link_status_t *status = reports->status;
    const bool armed = state_is_armed(status->state);
    const mavlink_heartbeat_t heartbeat = {
        .custom_mode = (uint32_t)status->state, /* as AVAILABLE_MODES names them */
        .type = MAV_TYPE_GENERIC,               /* programs have names of modes for others */
        .autopilot = MAV_AUTOPILOT_GENERIC,
        .base_mode =
            (uint8_t)(MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (armed ? MAV_MODE_FLAG_SAFETY_ARMED : 0)),
        .system_status = system_status(status->state),
        .mavlink_version = 3,
    };
    CHANNEL_SEND(channel, HEARTBEAT, &heartbeat);
}

mavlink_tailbeat_status_t reports_status_message(const reports_t *reports) {
    const link_status_t *status = reports->status;
    const memory_t *memory = status->memory;
    return (mavlink_tailbeat_status_t){
        .time_boot_ms = outbox_boot_ms(reports->outbox),
        .trial = status->trial,
        .next_trial = status->next_trial,
        .pending_trial = status->pending_trial,
        .reference_crc = status->reference_crc,
        .last_learned_trial = memory->last_trial,
        .best_max_abs_error_m_s =
            memory->best_iteration != 0 ? memory->best_max_abs_error_m_s : NAN,
        .iteration = memory->iteration,
        .best_iteration = memory->best_iteration,
        .beats = status->beats,
        .beat = status->beat,
        .fault = (uint16_t)status->fault,
        .battery_mv = status->battery.mv,
        .battery_at_limit = status->battery.at_limit,
        .state = (uint8_t)status->state,
        .worse_streak =
            (uint8_t)(memory->worse_streak < UINT8_MAX ? memory->worse_streak : UINT8_MAX),
    };
}

void reports_status(const reports_t *reports, channel_t *channel) {
    const mavlink_tailbeat_status_t fields = reports_status_message(reports);
    CHANNEL_SEND(channel, TAILBEAT_STATUS, &fields);
}

void reports_battery(const reports_t *reports, channel_t *channel) {
    mavlink_battery_status_t battery = {
        .current_consumed = -1,
        .energy_consumed = -1,
        .temperature = INT16_MAX,
        .current_battery = -1,
        .battery_remaining = -1,
        .battery_function = MAV_BATTERY_FUNCTION_ALL,
        .type = MAV_BATTERY_TYPE_UNKNOWN,
    };
    memset(battery.voltages, 0xFF, sizeof battery.voltages);
    if (!reports->status->battery.at_limit) {
        battery.voltages[0] = reports->status->battery.mv;
    }
    CHANNEL_SEND(channel, BATTERY_STATUS, &battery);
}

void reports_sys_status(const reports_t *reports, channel_t *channel) {
    const battery_voltage_t *battery = &reports->status->battery;
    const uint32_t imu = MAV_SYS_STATUS_SENSOR_3D_GYRO | MAV_SYS_STATUS_SENSOR_3D_ACCEL;
    const uint32_t sensors = imu | MAV_SYS_STATUS_SENSOR_BATTERY;
    mavlink_sys_status_t fields = {
        .onboard_control_sensors_present = sensors,
        .onboard_control_sensors_enabled = sensors,
        .onboard_control_sensors_health =
            (reports->status->imu->driver.problem == IMU_PROBLEM_NONE ? imu : 0) |
            (battery->at_limit ? 0 : MAV_SYS_STATUS_SENSOR_BATTERY) |
            MAV_SYS_STATUS_GEOFENCE, /* there is none: MAVProxy would report a breach of it */
        .voltage_battery = battery->at_limit ? UINT16_MAX : battery->mv,
        .current_battery = -1,
        .battery_remaining = -1,
    };
    CHANNEL_SEND(channel, SYS_STATUS, &fields);
}

void reports_attitude(const reports_t *reports, channel_t *channel) {
    const imu_frame_t *imu = &reports->status->imu->last;
    const mavlink_attitude_t attitude = {
        .time_boot_ms = outbox_boot_ms(reports->outbox),
        .roll = imu->ypr_deg[2] * REAL_RAD_PER_DEG,
        .pitch = imu->ypr_deg[1] * REAL_RAD_PER_DEG,
        .yaw = imu->ypr_deg[0] * REAL_RAD_PER_DEG,
        .rollspeed = imu->rate_rad_s[0],
        .pitchspeed = imu->rate_rad_s[1],
        .yawspeed = imu->rate_rad_s[2],
    };
    CHANNEL_SEND(channel, ATTITUDE, &attitude);
}

void reports_live(const reports_t *reports, channel_t *channel) {
    const link_status_t *status = reports->status;
    const float *ypr_deg = status->imu->last.ypr_deg;
    const mavlink_tailbeat_live_t live = {
        .time_boot_ms = outbox_boot_ms(reports->outbox),
        .angle_rad = status->angle_rad,
        .amplitude_rad = status->amplitude_rad,
        .speed_m_s = status->speed_m_s,
        .yaw_rad = ypr_deg[0] * REAL_RAD_PER_DEG,
        .pitch_rad = ypr_deg[1] * REAL_RAD_PER_DEG,
        .roll_rad = ypr_deg[2] * REAL_RAD_PER_DEG,
        .beat = status->beat,
        .pulse_ticks = status->pulse_ticks,
    };
    CHANNEL_SEND(channel, TAILBEAT_LIVE, &live);
}

void reports_learned(const reports_t *reports, channel_t *channel) {
    const mavlink_tailbeat_learn_report_t fields = trial_reports_learned(reports->status->learned);
    CHANNEL_SEND(channel, TAILBEAT_LEARN_REPORT, &fields);
}
