#include "link/health_reports.h"

#include "hal/system.h"

#include <string.h>

static uint32_t overruns(const reports_t *reports) {
    uint32_t sum = 0;
    for (uint32_t port = 0; port < HAL_PORT_COUNT; port++) {
        sum += hal_serial_errors(reports->outbox->hal, (hal_port_t)port).overruns;
    }
    return sum;
}

void health_reports_counters(const reports_t *reports, channel_t *channel) {
    const link_status_t *status = reports->status;
    const outbox_t *outbox = reports->outbox;
    const speed_counters_t *speed = &status->speed_counters;
    const imu_t *imu = status->imu;
    const imu_reader_counters_t *reader = &imu->reader.counters;
    const signing_counters_t *refused = &outbox->signing.counters;
    const mavlink_tailbeat_health_t health = {
        .imu_frames = imu->counters.frames,
        .imu_crc_failed = reader->crc_failed,
        .imu_implausible = imu->counters.implausible,
        .imu_skipped_bytes = reader->skipped_bytes,
        .imu_header_rejects = reader->header_rejects,
        .imu_checksum_failed = reader->checksum_failed,
        .imu_lost = imu->sequence.lost,
        .imu_restarts = imu->sequence.restarts,
        .serial_overruns = overruns(reports),
        .link_bad_frames = outbox->channel[0].bad_frames + outbox->channel[1].bad_frames,
        .link_dropped = outbox->channel[0].dropped + outbox->channel[1].dropped,
        .vision_accepted = speed->accepted,
        .vision_rejected = speed->implausible + speed->late + speed->early,
        .late_ticks = status->late_ticks,
        .store_failures = reports->store->failures,
        .store_free_bytes = store_free_bytes(reports->store),
        .longest_pause_us = status->longest_pause_us,
        .refused_unsigned = refused->unsigned_,
        .refused_wrong = refused->wrong,
        .refused_stale = refused->stale,
        .radio_framing = hal_serial_errors(outbox->hal, HAL_PORT_RADIO).framing,
        .imu_health = imu->health,
        .reset_cause = (uint8_t)hal_reset_cause(outbox->hal),
        .imu_problem = (uint8_t)imu->driver.problem,
    };
    CHANNEL_SEND(channel, TAILBEAT_HEALTH, &health);
}

void health_reports_imu(const reports_t *reports, channel_t *channel) {
    const imu_driver_t *driver = &reports->status->imu->driver;
    mavlink_tailbeat_imu_info_t info = {
        .baud = driver->found_baud != 0 ? driver->line_baud : 0,
        .still_s = reports->status->still_s,
        .rate_hz = driver->config.rate_hz,
        .port = driver->found_port,
        .state = (uint8_t)driver->state,
        .problem = (uint8_t)driver->problem,
        .error = driver->error_code,
    };
    memcpy(info.model, driver->model, sizeof info.model);
    memcpy(info.firmware, driver->firmware, sizeof info.firmware);
    CHANNEL_SEND(channel, TAILBEAT_IMU_INFO, &info);
}
