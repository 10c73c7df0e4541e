#include "link/telemetry.h"

#include "base/crc.h"
#include "hal/clock.h"
#include "link/health_reports.h"

#include <string.h>

#define SECOND_US 1000000u
#define HEALTH_PERIOD_US 5000000u
/* 50 Hz is what a tick can tell. */
#define INTERVAL_MIN_US 20000.0f

/* True once per |period_us|; a missed period is not made up for. */
static bool is_due(uint64_t now_us, uint64_t *next_us, uint32_t period_us) {
    if (now_us < *next_us) {
        return false;
    }
    *next_us = *next_us + period_us > now_us ? *next_us + period_us : now_us + period_us;
    return true;
}

static void send_heartbeats(const reports_t *reports) {
    for (uint32_t i = 0; i < OUTBOX_PORTS; i++) {
        reports_heartbeat(reports, &reports->outbox->channel[i]);
    }
}

/* On every port where a host is heard, but not on |filled_port|. */
static void send_to_heard(const reports_t *reports, reports_send_t send, uint32_t filled_port) {
    for (uint32_t i = 0; i < OUTBOX_PORTS; i++) {
        channel_t *channel = &reports->outbox->channel[i];
        if (outbox_heard(reports->outbox, channel) && i != filled_port) {
            send(reports, channel);
        }
    }
}

/* Messages whose rate a host may choose. */
static const struct {
    uint32_t message;
    reports_send_t send;
} paced[TELEMETRY_INTERVALS] = {
    {MAVLINK_MSG_ID_ATTITUDE, reports_attitude},
    {MAVLINK_MSG_ID_BATTERY_STATUS, reports_battery},
    {MAVLINK_MSG_ID_TAILBEAT_LIVE, reports_live},
};

static uint32_t paced_index(uint32_t message) {
    uint32_t index = 0;
    while (index < TELEMETRY_INTERVALS && paced[index].message != message) {
        index++;
    }
    return index;
}

bool telemetry_has_interval(uint32_t message) { return paced_index(message) < TELEMETRY_INTERVALS; }

bool telemetry_set_interval(telemetry_t *telemetry, hal_port_t port, uint32_t message,
                            float interval_us) {
    telemetry_interval_t *interval = &telemetry->interval[port][paced_index(message)];
    if (!interval_read(interval_us, INTERVAL_MIN_US, &interval->chosen)) {
        return false;
    }
    interval->next_us = 0;
    return true;
}

/* 0 = not sent. */
static uint32_t usual_interval_us(const telemetry_t *telemetry, uint32_t index) {
    if (paced[index].send != reports_live) {
        return SECOND_US;
    }
    const int32_t rate_hz = params_whole(telemetry->params, PARAM_TLM_RATE_HZ);
    return rate_hz > 0 ? SECOND_US / (uint32_t)rate_hz : 0;
}

/* Without an IMU there is no attitude. */
static bool has_data(const telemetry_t *telemetry, uint32_t index) {
    return paced[index].send != reports_attitude ||
           telemetry->reports->status->imu->counters.frames != 0;
}

/* The next host has chosen nothing yet. */
static void forget_choices(telemetry_t *telemetry, uint32_t port) {
    memset(telemetry->interval[port], 0, sizeof telemetry->interval[port]);
}

/* |listens|: when not, the times go on and nothing is sent. */
static void send_paced_to(telemetry_t *telemetry, channel_t *channel, uint64_t now_us,
                          bool listens) {
    telemetry_interval_t *interval = telemetry->interval[channel->port];
    for (uint32_t i = 0; i < TELEMETRY_INTERVALS; i++, interval++) {
        const uint32_t usual_us = usual_interval_us(telemetry, i);
        const uint32_t period_us = interval->chosen.us != 0 ? interval->chosen.us : usual_us;
        if (period_us != 0 && is_due(now_us, &interval->next_us, period_us) && listens &&
            !interval->chosen.off && has_data(telemetry, i)) {
            paced[i].send(telemetry->reports, channel);
        }
    }
}

static void send_paced(telemetry_t *telemetry, uint64_t now_us, uint32_t filled_port) {
    outbox_t *outbox = telemetry->reports->outbox;
    for (uint32_t port = 0; port < OUTBOX_PORTS; port++) {
        channel_t *channel = &outbox->channel[port];
        if (outbox_heard(outbox, channel)) {
            send_paced_to(telemetry, channel, now_us, port != filled_port);
        } else {
            forget_choices(telemetry, port);
        }
    }
}

/* The battery's last digits never rest; they alone are no news. */
static bool status_changed(telemetry_t *telemetry) {
    mavlink_tailbeat_status_t message = reports_status_message(telemetry->reports);
    message.time_boot_ms = 0;
    message.battery_mv = 0;
    message.battery_at_limit = 0;
    const uint32_t digest = crc32_update(0, &message, MAVLINK_MSG_ID_TAILBEAT_STATUS_LEN);
    const bool changed = digest != telemetry->status_digest;
    telemetry->status_digest = digest;
    return changed;
}

static bool imu_changed(telemetry_t *telemetry) {
    const imu_driver_t *driver = &telemetry->reports->status->imu->driver;
    const uint32_t digest = (uint32_t)driver->state | (uint32_t)driver->problem << 8 |
                            (uint32_t)driver->found_port << 16 | (uint32_t)driver->error_code << 24;
    const bool changed = digest != telemetry->imu_digest;
    telemetry->imu_digest = digest;
    return changed;
}

void telemetry_poll(telemetry_t *telemetry, uint32_t filled_port) {
    const reports_t *reports = telemetry->reports;
    const uint64_t now_us = hal_time_us(reports->outbox->hal);
    const bool changed = status_changed(telemetry);
    if (is_due(now_us, &telemetry->next_heartbeat_us, SECOND_US)) {
        send_heartbeats(reports);
    }
    if (is_due(now_us, &telemetry->next_slow_us, SECOND_US)) {
        send_to_heard(reports, reports_status, filled_port);
        send_to_heard(reports, reports_sys_status, filled_port);
    } else if (changed) {
        send_to_heard(reports, reports_status, OUTBOX_PORTS);
    }
    if (imu_changed(telemetry)) {
        send_to_heard(reports, health_reports_imu, OUTBOX_PORTS);
    }
    send_paced(telemetry, now_us, filled_port);
    if (is_due(now_us, &telemetry->next_health_us, HEALTH_PERIOD_US)) {
        send_to_heard(reports, health_reports_counters, filled_port);
    }
}
