#include "link/link_internal.h"

#include "base/real.h"
#include "base/units.h"
#include "hal/clock.h"
#include "hal/system.h"

#include <math.h>
#include <string.h>

#define VERSION_0_1_0 0x00010000u /* major, minor, patch, type: development */
#define HASH_CHARS 8u
#define HASH_MIN_CHARS 7u
#define TEXT_CHARS 49u
#define AMPLITUDES_PER_MESSAGE 32u

static uint32_t boot_ms(const link_t *link) {
    return (uint32_t)units_thousandth(hal_time_us(link->hal));
}

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

void link_send_heartbeat(link_t *link, channel_t *channel) {
    const link_status_t *status = link->status;
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
    LINK_SEND(channel, HEARTBEAT, &heartbeat);
}

mavlink_tailbeat_status_t link_status_message(const link_t *link) {
    const link_status_t *status = link->status;
    const memory_t *memory = status->memory;
    return (mavlink_tailbeat_status_t){
        .time_boot_ms = boot_ms(link),
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

void link_send_status(link_t *link, channel_t *channel) {
    const mavlink_tailbeat_status_t fields = link_status_message(link);
    LINK_SEND(channel, TAILBEAT_STATUS, &fields);
}

void link_send_battery(link_t *link, channel_t *channel) {
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
    if (!link->status->battery.at_limit) {
        battery.voltages[0] = link->status->battery.mv;
    }
    LINK_SEND(channel, BATTERY_STATUS, &battery);
}

void link_send_sys_status(link_t *link, channel_t *channel) {
    const battery_voltage_t *battery = &link->status->battery;
    const uint32_t imu = MAV_SYS_STATUS_SENSOR_3D_GYRO | MAV_SYS_STATUS_SENSOR_3D_ACCEL;
    const uint32_t sensors = imu | MAV_SYS_STATUS_SENSOR_BATTERY;
    mavlink_sys_status_t fields = {
        .onboard_control_sensors_present = sensors,
        .onboard_control_sensors_enabled = sensors,
        .onboard_control_sensors_health =
            (link->status->imu->driver.problem == IMU_PROBLEM_NONE ? imu : 0) |
            (battery->at_limit ? 0 : MAV_SYS_STATUS_SENSOR_BATTERY) |
            MAV_SYS_STATUS_GEOFENCE, /* there is none: MAVProxy would report a breach of it */
        .voltage_battery = battery->at_limit ? UINT16_MAX : battery->mv,
        .current_battery = -1,
        .battery_remaining = -1,
    };
    LINK_SEND(channel, SYS_STATUS, &fields);
}

void link_send_attitude(link_t *link, channel_t *channel) {
    const imu_frame_t *imu = &link->status->imu->last;
    const mavlink_attitude_t attitude = {
        .time_boot_ms = boot_ms(link),
        .roll = imu->ypr_deg[2] * REAL_RAD_PER_DEG,
        .pitch = imu->ypr_deg[1] * REAL_RAD_PER_DEG,
        .yaw = imu->ypr_deg[0] * REAL_RAD_PER_DEG,
        .rollspeed = imu->rate_rad_s[0],
        .pitchspeed = imu->rate_rad_s[1],
        .yawspeed = imu->rate_rad_s[2],
    };
    LINK_SEND(channel, ATTITUDE, &attitude);
}

void link_send_live(link_t *link, channel_t *channel) {
    const link_status_t *status = link->status;
    const float *ypr_deg = status->imu->last.ypr_deg;
    const mavlink_tailbeat_live_t live = {
        .time_boot_ms = boot_ms(link),
        .angle_rad = status->angle_rad,
        .amplitude_rad = status->amplitude_rad,
        .speed_m_s = status->speed_m_s,
        .yaw_rad = ypr_deg[0] * REAL_RAD_PER_DEG,
        .pitch_rad = ypr_deg[1] * REAL_RAD_PER_DEG,
        .roll_rad = ypr_deg[2] * REAL_RAD_PER_DEG,
        .beat = status->beat,
        .pulse_ticks = status->pulse_ticks,
    };
    LINK_SEND(channel, TAILBEAT_LIVE, &live);
}

static uint32_t overruns(const link_t *link) {
    uint32_t sum = 0;
    for (uint32_t port = 0; port < HAL_PORT_COUNT; port++) {
        sum += hal_serial_errors(link->hal, (hal_port_t)port).overruns;
    }
    return sum;
}

void link_send_health(link_t *link, channel_t *channel) {
    const link_status_t *status = link->status;
    const speed_counters_t *speed = &status->speed_counters;
    const imu_t *imu = status->imu;
    const imu_reader_counters_t *reader = &imu->reader.counters;
    const signing_counters_t *refused = &link->signing.counters;
    const mavlink_tailbeat_health_t health = {
        .imu_frames = imu->counters.frames,
        .imu_crc_failed = reader->crc_failed,
        .imu_implausible = imu->counters.implausible,
        .imu_skipped_bytes = reader->skipped_bytes,
        .imu_header_rejects = reader->header_rejects,
        .imu_checksum_failed = reader->checksum_failed,
        .imu_lost = imu->sequence.lost,
        .imu_restarts = imu->sequence.restarts,
        .serial_overruns = overruns(link),
        .link_bad_frames = link->channel[0].bad_frames + link->channel[1].bad_frames,
        .link_dropped = link->channel[0].dropped + link->channel[1].dropped,
        .vision_accepted = speed->accepted,
        .vision_rejected = speed->implausible + speed->late + speed->early,
        .late_ticks = status->late_ticks,
        .store_failures = link->store->failures,
        .store_free_bytes = store_free_bytes(link->store),
        .longest_pause_us = status->longest_pause_us,
        .refused_unsigned = refused->unsigned_,
        .refused_wrong = refused->wrong,
        .refused_stale = refused->stale,
        .radio_framing = hal_serial_errors(link->hal, HAL_PORT_RADIO).framing,
        .imu_health = imu->health,
        .reset_cause = (uint8_t)hal_reset_cause(link->hal),
        .imu_problem = (uint8_t)imu->driver.problem,
    };
    LINK_SEND(channel, TAILBEAT_HEALTH, &health);
}

void link_send_imu_info(link_t *link, channel_t *channel) {
    const imu_driver_t *driver = &link->status->imu->driver;
    mavlink_tailbeat_imu_info_t info = {
        .baud = driver->found_baud != 0 ? driver->line_baud : 0,
        .still_s = link->status->still_s,
        .rate_hz = driver->config.rate_hz,
        .port = driver->found_port,
        .state = (uint8_t)driver->state,
        .problem = (uint8_t)driver->problem,
        .error = driver->error_code,
    };
    memcpy(info.model, driver->model, sizeof info.model);
    memcpy(info.firmware, driver->firmware, sizeof info.firmware);
    LINK_SEND(channel, TAILBEAT_IMU_INFO, &info);
}

static float peak_of(const judge_peaks_t *peaks, uint32_t beat) {
    for (uint32_t i = 0; i < peaks->count; i++) {
        if (peaks->beat[i] == beat) {
            return peaks->error_m_s[i];
        }
    }
    return 0.0f;
}

static float amplitude_of(const memory_t *memory, uint8_t set, uint32_t beat) {
    switch (set) {
    case TAILBEAT_AMPLITUDE_SET_BEST:
        return memory->best_rad[beat];
    case TAILBEAT_AMPLITUDE_SET_VISITS:
        return (float)memory->visits[beat];
    case TAILBEAT_AMPLITUDE_SET_PEAKS:
        return peak_of(&memory->peaks, beat);
    default:
        return memory->amplitude_rad[beat];
    }
}

void link_send_amplitudes(link_t *link, channel_t *channel, uint8_t set, uint16_t first) {
    const bool best = set == TAILBEAT_AMPLITUDE_SET_BEST;
    const memory_t *memory = link->status->memory;
    mavlink_tailbeat_amplitudes_t piece = {
        .reference_crc = memory->reference_crc,
        .iteration = best ? memory->best_iteration : memory->iteration,
        .beats = memory->beats,
        .first = first,
        .set = set,
        .input = (uint8_t)memory->input,
    };
    for (uint32_t i = 0; i < AMPLITUDES_PER_MESSAGE && first + i < memory->beats; i++) {
        piece.amplitude_rad[i] = amplitude_of(memory, set, first + i);
        piece.count++;
    }
    LINK_SEND(channel, TAILBEAT_AMPLITUDES, &piece);
}

void link_send_learn_report(link_t *link, channel_t *channel) {
    const link_learn_report_t *learned = &link->last_learned;
    const memory_report_t *report = &learned->report;
    const mavlink_tailbeat_learn_report_t fields = {
        .trial = learned->trial,
        .max_abs_error_m_s = report->law.max_abs_error_m_s,
        .rms_error_m_s = report->law.rms_error_m_s,
        .best_max_abs_error_m_s = learned->best_max_abs_error_m_s,
        .iteration = learned->iteration,
        .measured_beats = report->law.measured_beats,
        .saturated_beats = report->law.saturated_beats,
        .flags = (uint8_t)((report->improved ? TAILBEAT_LEARN_IMPROVED : 0) |
                           (report->rolled_back ? TAILBEAT_LEARN_ROLLED_BACK : 0)),
    };
    LINK_SEND(channel, TAILBEAT_LEARN_REPORT, &fields);
}

static bool is_hex(char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); }

/* The commit's hash is the first long run of hexadecimal digits in what git describe says. */
static const char *find_hash(const char *id) {
    for (const char *at = id; *at != '\0'; at++) {
        uint32_t run = 0;
        while (run < HASH_MIN_CHARS && is_hex(at[run])) {
            run++;
        }
        if (run == HASH_MIN_CHARS) {
            return at;
        }
    }
    return id;
}

static void copy_hash(uint8_t out[HASH_CHARS]) {
    const char *hash = find_hash(link_build_id());
    for (uint32_t i = 0; i < HASH_CHARS && hash[i] != '\0'; i++) {
        out[i] = (uint8_t)hash[i];
    }
}

/* As common ground stations can show it. Any other board sends 0. */
static uint16_t board_number(const char *name) {
    static const char *const known[] = {"fish", "simulated", "emulated"};
    uint16_t number = sizeof known / sizeof known[0];
    while (number > 0 && strcmp(name, known[number - 1u]) != 0) {
        number--;
    }
    return number;
}

void link_send_version(link_t *link, channel_t *channel) {
    const uint16_t board = board_number(hal_board_name(link->hal));
    uint8_t unique_id[16];
    char text[TEXT_CHARS + 1] = "tailbeat ";
    mavlink_autopilot_version_t version = {
        .capabilities = MAV_PROTOCOL_CAPABILITY_FTP | MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST |
                        MAV_PROTOCOL_CAPABILITY_COMMAND_INT | MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        .flight_sw_version = VERSION_0_1_0,
        .board_version = board,
        .product_id = board,
    };
    hal_unique_id(link->hal, unique_id);
    memcpy(version.uid2, unique_id, sizeof unique_id);
    memcpy(&version.uid, unique_id, sizeof version.uid);
    copy_hash(version.flight_custom_version);
    LINK_SEND(channel, AUTOPILOT_VERSION, &version);
    strncat(text, link_build_id(), TEXT_CHARS - strlen(text));
    link_send_text(channel, MAV_SEVERITY_INFO, text);
}

void link_send_text(channel_t *channel, uint8_t severity, const char *text) {
    mavlink_statustext_t fields = {.severity = severity};
    for (uint32_t i = 0; i < TEXT_CHARS && text[i] != '\0'; i++) {
        fields.text[i] = text[i];
    }
    LINK_SEND(channel, STATUSTEXT, &fields);
}

void link_text(link_t *link, uint8_t severity, const char *text) {
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        link_send_text(&link->channel[i], severity, text);
    }
}

void link_beat(link_t *link, const link_beat_t *beat) {
    const mavlink_tailbeat_beat_t fields = {
        .trial = beat->trial,
        .amplitude_rad = beat->amplitude_rad,
        .reference_m_s = beat->reference_m_s,
        .speed_m_s = beat->speed.speed_m_s,
        .sigma_m_s = beat->speed.sigma_m_s,
        .beat = beat->beat,
        .samples = beat->speed.samples,
        .flags = (uint8_t)((beat->speed.measured ? TAILBEAT_BEAT_MEASURED : 0) |
                           (beat->saturated ? TAILBEAT_BEAT_SATURATED : 0) |
                           (beat->provisional ? TAILBEAT_BEAT_PROVISIONAL : 0)),
    };
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        if (link_heard(link, &link->channel[i])) {
            LINK_SEND(&link->channel[i], TAILBEAT_BEAT, &fields);
        }
    }
}

void link_learned(link_t *link, const link_learn_report_t *report) {
    link->last_learned = *report;
    link_send_to_heard(link, link_send_learn_report);
}
