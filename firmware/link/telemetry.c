#include "link/link_internal.h"

#include "base/crc.h"
#include "hal/clock.h"

#define SECOND_US 1000000u
#define HEALTH_PERIOD_US 5000000u
/* 50 Hz is what a tick can tell. */
#define INTERVAL_MIN_US 20000.0f
#define INTERVAL_MAX_US 1e7f

/* True once per |period_us|; a missed period is not made up for. */
static bool is_due(uint64_t *next_us, uint64_t now_us, uint64_t period_us) {
    if (now_us < *next_us) {
        return false;
    }
    *next_us = *next_us + period_us > now_us ? *next_us + period_us : now_us + period_us;
    return true;
}

static void send_heartbeats(link_t *link) {
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        link_send_heartbeat(link, &link->channel[i]);
    }
}

/* A file that is being pulled gets the line to itself, if who pulls it is trusted; what changes is
 * told all the same. */
static bool is_filled(const link_t *link, const channel_t *channel) {
    return link->ftp.bursting && link->ftp.owner.trusted &&
           link->ftp.owner.port == (uint8_t)channel->port && link->status->open_trial == 0;
}

static void send_regularly(link_t *link, link_send_t send) {
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        channel_t *channel = &link->channel[i];
        if (link_heard(link, channel) && !is_filled(link, channel)) {
            send(link, channel);
        }
    }
}

/* Messages whose rate a host may choose. */
static const struct {
    uint32_t message;
    link_send_t send;
} paced[LINK_INTERVALS] = {
    {MAVLINK_MSG_ID_ATTITUDE, link_send_attitude},
    {MAVLINK_MSG_ID_BATTERY_STATUS, link_send_battery},
    {MAVLINK_MSG_ID_TAILBEAT_LIVE, link_send_live},
};

static uint32_t paced_index(uint32_t message) {
    uint32_t index = 0;
    while (index < LINK_INTERVALS && paced[index].message != message) {
        index++;
    }
    return index;
}

bool link_has_interval(uint32_t message) { return paced_index(message) < LINK_INTERVALS; }

bool link_set_interval(link_t *link, hal_port_t port, uint32_t message, float interval_us) {
    link_interval_t *interval = &link->interval[port][paced_index(message)];
    const bool off = interval_us == -1.0f, usual = interval_us == 0.0f;
    if (!off && !usual && !(interval_us >= INTERVAL_MIN_US && interval_us <= INTERVAL_MAX_US)) {
        return false;
    }
    interval->off = off;
    interval->interval_us = off ? 0 : (uint32_t)interval_us;
    interval->next_us = 0;
    return true;
}

/* 0 = not sent. */
static uint64_t usual_interval_us(const link_t *link, uint32_t index) {
    if (paced[index].send != link_send_live) {
        return SECOND_US;
    }
    const int32_t rate_hz = params_whole(link->params, PARAM_TLM_RATE_HZ);
    return rate_hz > 0 ? SECOND_US / (uint32_t)rate_hz : 0;
}

/* Without an IMU there is no attitude. */
static bool has_data(const link_t *link, uint32_t index) {
    return paced[index].send != link_send_attitude || link->status->imu->counters.frames != 0;
}

static void send_paced(link_t *link, uint64_t now_us) {
    for (uint32_t port = 0; port < LINK_PORTS; port++) {
        channel_t *channel = &link->channel[port];
        const bool heard = link_heard(link, channel);
        const bool listens = heard && !is_filled(link, channel);
        for (uint32_t i = 0; i < LINK_INTERVALS; i++) {
            link_interval_t *interval = &link->interval[port][i];
            if (!heard) {
                *interval = (link_interval_t){0}; /* the next host has chosen nothing yet */
                continue;
            }
            const uint64_t usual_us = usual_interval_us(link, i);
            const uint64_t period_us =
                interval->interval_us != 0 ? interval->interval_us : usual_us;
            if (period_us != 0 && is_due(&interval->next_us, now_us, period_us) && listens &&
                !interval->off && has_data(link, i)) {
                paced[i].send(link, channel);
            }
        }
    }
}

static void send_slow(link_t *link) {
    send_regularly(link, link_send_status);
    send_regularly(link, link_send_sys_status);
}

/* The battery's last digits never rest; they alone are no news. */
static bool status_changed(link_t *link) {
    mavlink_tailbeat_status_t message = link_status_message(link);
    message.time_boot_ms = 0;
    message.battery_mv = 0;
    message.battery_at_limit = 0;
    const uint32_t digest = crc32_update(0, &message, MAVLINK_MSG_ID_TAILBEAT_STATUS_LEN);
    const bool changed = digest != link->status_digest;
    link->status_digest = digest;
    return changed;
}

static bool imu_changed(link_t *link) {
    const imu_driver_t *driver = &link->status->imu->driver;
    const uint32_t digest = (uint32_t)driver->state | (uint32_t)driver->problem << 8 |
                            (uint32_t)driver->found_port << 16 | (uint32_t)driver->error_code << 24;
    const bool changed = digest != link->imu_digest;
    link->imu_digest = digest;
    return changed;
}

void link_telemetry(link_t *link) {
    const uint64_t now_us = hal_time_us(link->hal);
    const bool changed = status_changed(link);
    if (is_due(&link->next_heartbeat_us, now_us, SECOND_US)) {
        send_heartbeats(link);
    }
    if (is_due(&link->next_slow_us, now_us, SECOND_US)) {
        send_slow(link);
    } else if (changed) {
        link_send_to_heard(link, link_send_status);
    }
    if (imu_changed(link)) {
        link_send_to_heard(link, link_send_imu_info);
    }
    send_paced(link, now_us);
    if (is_due(&link->next_health_us, now_us, HEALTH_PERIOD_US)) {
        send_regularly(link, link_send_health);
    }
}
