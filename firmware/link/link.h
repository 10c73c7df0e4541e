/*
 * The wire: MAVLink 2 on two ports, dialect wire/tailbeat.xml, sysid 1, compid 1.
 *
 * Composes the parts of the link and hands each message that arrives to one of them. What a command
 * does is the application's: it is handed over through link_handlers_t. What the application sends
 * goes through link.outbox (outbox.h, trial_reports.h). Main loop only. Everything sent is dropped
 * and counted when the line is full; answers to requests are not queued beyond what the port holds.
 * A port's line must hold at least LINK_LINE_MIN_BYTES, or file bursts never start.
 *
 * With a key (signing.h) every command, parameter write, file write and speed sample must be signed
 * and fresh, else it is refused, answered with the reason and counted. COMMAND_ACK tells whether
 * another try is worth while: TEMPORARILY_REJECTED = the right key at a wrong time (adopt the
 * board's), DENIED = no key or another one. Reading is free: parameters, lists and files, TIMESYNC,
 * HEARTBEAT. An unsigned HEARTBEAT brings telemetry to its port, but does not reach the
 * application. A frame with a wrong signature is good for nothing but a refusal. All that is sent
 * is signed.
 *
 * What the application gets through the handlers is finite where a number has to be, and addressed
 * to this board.
 */
#ifndef LINK_LINK_H
#define LINK_LINK_H

#include "link/build_id.h"
#include "link/commands.h"
#include "link/discovery.h"
#include "link/ftp_server.h"
#include "link/handlers.h"
#include "link/imu_stream.h"
#include "link/outbox.h"
#include "link/params_server.h"
#include "link/reports.h"
#include "link/status.h"
#include "link/telemetry.h"
#include "link/trial_reports.h"

#define LINK_LINE_MIN_BYTES 559u
#define LINK_POLL_US 20000u

typedef struct {
    link_handlers_t handlers;
    reports_t reports;
    discovery_t discovery;
    params_server_t params_server;
    commands_t commands;
    telemetry_t telemetry;
    imu_stream_t imu_stream;
    ftp_server_t ftp;
    outbox_t outbox;
} link_t;

void link_init(link_t *link, hal_t *hal, store_t *store, params_t *params,
               const link_handlers_t *handlers);

/* Takes in what has arrived (bounded: what the rings held, and LINK_POLL_US beyond one message of
 * each port), answers it, sends what is due. |status| is read until the next poll. */
void link_poll(link_t *link, const link_status_t *status);

/* A frame of the IMU, for the host that asked for all of them. */
void link_imu(link_t *link, const imu_sample_t *sample);

#endif
