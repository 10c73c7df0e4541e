#include "link/message_requests.h"

#include "link/amplitudes.h"
#include "link/health_reports.h"
#include "link/identity.h"

static reports_send_t find_sender(uint32_t message) {
    static const struct {
        uint32_t message;
        reports_send_t send;
    } senders[] = {
        {MAVLINK_MSG_ID_HEARTBEAT, reports_heartbeat},
        {MAVLINK_MSG_ID_AUTOPILOT_VERSION, identity_version},
        {MAVLINK_MSG_ID_COMPONENT_METADATA, identity_metadata},
        {MAVLINK_MSG_ID_SYS_STATUS, reports_sys_status},
        {MAVLINK_MSG_ID_BATTERY_STATUS, reports_battery},
        {MAVLINK_MSG_ID_TAILBEAT_STATUS, reports_status},
        {MAVLINK_MSG_ID_TAILBEAT_LEARN_REPORT, reports_learned},
        {MAVLINK_MSG_ID_TAILBEAT_HEALTH, health_reports_counters},
        {MAVLINK_MSG_ID_TAILBEAT_IMU_INFO, health_reports_imu},
    };
    for (uint32_t i = 0; i < sizeof senders / sizeof senders[0]; i++) {
        if (senders[i].message == message) {
            return senders[i].send;
        }
    }
    return NULL;
}

/* A message that is asked for, with what the parameters of the request say of it. */
typedef struct {
    uint32_t message;
    uint32_t first; /* beat of TAILBEAT_AMPLITUDES; index of AVAILABLE_MODES */
    uint32_t set;   /* of TAILBEAT_AMPLITUDES */
} wanted_t;

static bool read_wanted(const message_requests_t *requests, const command_request_t *request,
                        wanted_t *wanted) {
    const uint16_t beats = requests->reports->status->memory->beats;
    if (!command_read_whole(request->param1, 0.0f, COMMAND_WHOLE_MAX, &wanted->message)) {
        return false;
    }
    if (wanted->message == MAVLINK_MSG_ID_AVAILABLE_MODES) {
        return command_read_whole(request->param2, 0.0f, (float)STATE_COUNT, &wanted->first);
    }
    return wanted->message != MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES ||
           (command_read_whole(request->param2, 0.0f, beats > 0 ? (float)(beats - 1u) : 0.0f,
                               &wanted->first) &&
            command_read_whole(request->param3, TAILBEAT_AMPLITUDE_SET_NEXT,
                               TAILBEAT_AMPLITUDE_SET_PEAKS, &wanted->set));
}

static void send_wanted(const message_requests_t *requests, channel_t *channel,
                        const wanted_t *wanted) {
    const reports_t *reports = requests->reports;
    if (wanted->message == MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES) {
        amplitudes_send(reports->status->memory, channel, (uint8_t)wanted->set,
                        (uint16_t)wanted->first);
    } else if (wanted->message == MAVLINK_MSG_ID_AVAILABLE_MODES) {
        discovery_send_modes(requests->discovery, channel, wanted->first);
    } else {
        find_sender(wanted->message)(reports, channel);
    }
}

static bool can_send(uint32_t message) {
    return message == MAVLINK_MSG_ID_TAILBEAT_AMPLITUDES ||
           message == MAVLINK_MSG_ID_AVAILABLE_MODES || find_sender(message) != NULL;
}

void message_requests_send(const message_requests_t *requests, const received_t *in,
                           const command_request_t *request) {
    wanted_t wanted;
    if (!read_wanted(requests, request, &wanted)) {
        command_answer_explain(in, request->command, command_bad_values);
    } else if (!can_send(wanted.message)) {
        command_answer_send(in, request->command, command_unsupported);
    } else {
        command_answer_send(in, request->command, command_accepted);
        send_wanted(requests, in->channel, &wanted);
    }
}

command_answer_t message_requests_set_interval(const message_requests_t *requests,
                                               const received_t *in,
                                               const command_request_t *request) {
    const hal_port_t port = in->channel->port;
    const float interval_us = request->param2;
    uint32_t message = 0;
    bool is_set = false;
    if (!command_read_whole(request->param1, 0.0f, COMMAND_WHOLE_MAX, &message)) {
        return command_bad_values;
    }
    if (message == MAVLINK_MSG_ID_TAILBEAT_IMU) {
        is_set = imu_stream_set_interval(requests->imu_stream, port, interval_us);
    } else if (telemetry_has_interval(message)) {
        is_set = telemetry_set_interval(requests->telemetry, port, message, interval_us);
    } else {
        return command_unsupported;
    }
    return is_set ? command_accepted : command_bad_values;
}
