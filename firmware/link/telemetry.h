/*
 * What the board sends without being asked: HEARTBEAT, status, health, and messages whose rate a
 * host may choose. Main loop only.
 */
#ifndef LINK_TELEMETRY_H
#define LINK_TELEMETRY_H

#include "link/interval.h"
#include "link/reports.h"
#include "params/params.h"

/* When a message is sent on a port. */
typedef struct {
    interval_t chosen; /* by the host; zeros = as usual */
    uint64_t next_us;
} telemetry_interval_t;

#define TELEMETRY_INTERVALS 3u /* messages whose rate a host may choose */

/* Begins as zeros, but for the pointers. */
typedef struct {
    const reports_t *reports;
    const params_t *params;
    telemetry_interval_t interval[OUTBOX_PORTS][TELEMETRY_INTERVALS];
    uint64_t next_heartbeat_us, next_slow_us, next_health_us;
    uint32_t status_digest, imu_digest; /* of what was sent last */
} telemetry_t;

/* Sends what is due. The line of |filled_port| is left to a file that is being downloaded;
 * OUTBOX_PORTS = none. Changes are sent there all the same. */
void telemetry_poll(telemetry_t *telemetry, uint32_t filled_port);

/* MAV_CMD_SET_MESSAGE_INTERVAL for a message that is sent regularly, on one port: -1 = not at all,
 * 0 = as usual; false = out of range. It lasts until no host is heard there any more. */
bool telemetry_has_interval(uint32_t message);
bool telemetry_set_interval(telemetry_t *telemetry, hal_port_t port, uint32_t message,
                            float interval_us);

#endif
