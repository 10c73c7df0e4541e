/* MAV_CMD_REQUEST_MESSAGE and MAV_CMD_SET_MESSAGE_INTERVAL. */
#ifndef LINK_MESSAGE_REQUESTS_H
#define LINK_MESSAGE_REQUESTS_H

#include "link/command_answer.h"
#include "link/command_reader.h"
#include "link/discovery.h"
#include "link/imu_stream.h"
#include "link/telemetry.h"

/* Who sends what may be asked for. */
typedef struct {
    const reports_t *reports;
    telemetry_t *telemetry;
    discovery_t *discovery;
    imu_stream_t *imu_stream;
} message_requests_t;

/* Answers the command, then sends the message. */
void message_requests_send(const message_requests_t *requests, const received_t *in,
                           const command_request_t *request);

command_answer_t message_requests_set_interval(const message_requests_t *requests,
                                               const received_t *in,
                                               const command_request_t *request);

#endif
