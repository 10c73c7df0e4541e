#include "link/link_internal.h"

#include "base/real.h"
#include "hal/clock.h"

#include <math.h>
#include <string.h>

#define MESSAGES_PER_POLL 32u /* per port: more than the rings hold of all but the shortest */
#define BURST_PACKETS_PER_POLL 4u

void link_init(link_t *link, hal_t *hal, store_t *store, params_t *params,
               const link_handlers_t *handlers) {
    memset(link, 0, sizeof *link);
    link->hal = hal;
    link->store = store;
    link->params = params;
    link->handlers = *handlers;
    ftp_server_init(&link->ftp, store);
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        channel_init(&link->channel[i], hal, (hal_port_t)i);
        channel_sign(&link->channel[i], &link->signing);
        link->param_stream_next[i] = PARAM_COUNT;
        link->mode_stream_next[i] = STATE_COUNT;
    }
}

bool link_addressed(uint8_t system, uint8_t component) {
    return (system == LINK_SYSTEM || system == 0) &&
           (component == LINK_COMPONENT || component == 0);
}

bool link_heard(const link_t *link, const channel_t *channel) {
    return hal_time_us(link->hal) < link->heard_until_us[channel->port];
}

void link_send_to_heard(link_t *link, link_send_t send) {
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        if (link_heard(link, &link->channel[i])) {
            send(link, &link->channel[i]);
        }
    }
}

/* Another fish, and not a host that calls itself a generic one. Earlier firmware was a submarine.
 */
static bool is_board(const mavlink_message_t *message) {
    const uint8_t type = mavlink_msg_heartbeat_get_type(message);
    return (type == MAV_TYPE_GENERIC || type == MAV_TYPE_SUBMARINE) &&
           mavlink_msg_heartbeat_get_autopilot(message) == MAV_AUTOPILOT_GENERIC &&
           (mavlink_msg_heartbeat_get_base_mode(message) & MAV_MODE_FLAG_CUSTOM_MODE_ENABLED) != 0;
}

static void on_heartbeat(link_t *link, const link_received_t *in) {
    if (in->verdict == SIGNING_TRUSTED && !is_board(in->message)) {
        link->handlers.heartbeat(link->handlers.context, in->channel->port, in->message->sysid,
                                 in->message->compid);
    }
}

/* A request has tc1 = 0; what else comes is the answer to somebody's request. */
static void on_timesync(link_t *link, const link_received_t *in) {
    mavlink_timesync_t sync;
    mavlink_msg_timesync_decode(in->message, &sync);
    if (sync.tc1 != 0) {
        return;
    }
    sync.tc1 = (int64_t)(hal_time_us(link->hal) * 1000u);
    LINK_SEND(in->channel, TIMESYNC, &sync);
}

/* A variance of 0 is a field that was left out: MAVLink 1, or zeros cut off the end. */
static float sigma_of(float variance) {
    return real_is_finite(variance) && variance > 0.0f ? real_sqrt(variance) : NAN;
}

static void on_vision(link_t *link, const link_received_t *in) {
    if (link_refusal(link, in) != FAULT_NONE) {
        return;
    }
    mavlink_vision_speed_estimate_t estimate;
    mavlink_msg_vision_speed_estimate_decode(in->message, &estimate);
    const link_vision_t sample = {
        .time_us = estimate.usec,
        .speed_m_s = estimate.x,
        .sigma_m_s = sigma_of(estimate.covariance[0]),
    };
    link->handlers.vision(link->handlers.context, &sample);
}

static void address_ftp(mavlink_file_transfer_protocol_t *reply, ftp_host_t host) {
    reply->target_network = 0;
    reply->target_system = host.system;
    reply->target_component = host.component;
}

static void on_ftp(link_t *link, const link_received_t *in) {
    /* In place: with a copy of it this would be the deepest stack of all. */
    const mavlink_file_transfer_protocol_t *request =
        (const mavlink_file_transfer_protocol_t *)(const void *)_MAV_PAYLOAD(in->message);
    mavlink_file_transfer_protocol_t reply;
    if (!link_addressed(request->target_system, request->target_component)) {
        return;
    }
    const ftp_host_t host = {in->message->sysid, in->message->compid, (uint8_t)in->channel->port,
                             in->verdict == SIGNING_TRUSTED};
    const bool wrong = in->verdict == SIGNING_WRONG;
    if (wrong || ftp_server_needs_trust(request->payload)) {
        (void)link_refusal(link, in);
    }
    const bool answered =
        wrong ? ftp_server_refuse(request->payload, reply.payload)
              : ftp_server_request(&link->ftp, host, request->payload, reply.payload);
    if (answered) {
        address_ftp(&reply, host);
        LINK_SEND(in->channel, FILE_TRANSFER_PROTOCOL, &reply);
    }
}

/* While a trial's log is open only it may write flash. */
static void set_ftp_conditions(link_t *link) {
    link->ftp.conditions = (ftp_conditions_t){
        .now_us = hal_time_us(link->hal),
        .read_only = link->status->open_trial != 0,
        .busy_trial = link->status->open_trial,
    };
}

static void stream_burst(link_t *link) {
    const size_t needed =
        LINK_FRAME_BYTES + MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL_LEN + LINK_RESERVE_BYTES;
    channel_t *channel = &link->channel[link->ftp.owner.port];
    mavlink_file_transfer_protocol_t reply;
    for (uint32_t i = 0; i < BURST_PACKETS_PER_POLL && channel_has_space(channel, needed); i++) {
        if (!ftp_server_burst(&link->ftp, reply.payload)) {
            return;
        }
        address_ftp(&reply, link->ftp.owner);
        LINK_SEND(channel, FILE_TRANSFER_PROTOCOL, &reply);
    }
}

typedef struct {
    uint32_t message;
    bool refuses; /* has an answer for a wrong signature */
    void (*handle)(link_t *link, const link_received_t *in);
} route_t;

static const route_t routes[] = {
    {MAVLINK_MSG_ID_HEARTBEAT, false, on_heartbeat},
    {MAVLINK_MSG_ID_TIMESYNC, false, on_timesync},
    {MAVLINK_MSG_ID_VISION_SPEED_ESTIMATE, true, on_vision},
    {MAVLINK_MSG_ID_COMMAND_LONG, true, link_on_command_long},
    {MAVLINK_MSG_ID_COMMAND_INT, true, link_on_command_int},
    {MAVLINK_MSG_ID_PARAM_REQUEST_LIST, false, link_on_param_request_list},
    {MAVLINK_MSG_ID_PARAM_REQUEST_READ, false, link_on_param_request_read},
    {MAVLINK_MSG_ID_PARAM_SET, true, link_on_param_set},
    {MAVLINK_MSG_ID_MISSION_REQUEST_LIST, false, link_on_mission_request_list},
    {MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL, true, on_ftp},
    {MAVLINK_MSG_ID_SETUP_SIGNING, true, link_on_setup_signing},
};

static const route_t *find_route(uint32_t message) {
    for (uint32_t i = 0; i < sizeof routes / sizeof routes[0]; i++) {
        if (routes[i].message == message) {
            return &routes[i];
        }
    }
    return NULL;
}

static void dispatch(link_t *link, channel_t *channel, const mavlink_message_t *message) {
    /* Our own words come back from a modem that echoes. */
    if (message->sysid == LINK_SYSTEM && message->compid == LINK_COMPONENT) {
        return;
    }
    const uint64_t now_us = hal_time_us(link->hal);
    const link_received_t in = {channel, message, signing_check(&link->signing, message, now_us)};
    const bool wrong = in.verdict == SIGNING_WRONG;
    if (!wrong) {
        link->heard_until_us[channel->port] = now_us + LINK_HEARD_US;
    }
    const route_t *route = find_route(message->msgid);
    if (route != NULL && (!wrong || route->refuses)) {
        set_ftp_conditions(link);
        route->handle(link, &in);
    }
}

/* A list of files takes long to make, and a host may ask for many: the board has more to do. */
static void take_in(link_t *link, channel_t *channel, uint64_t until_us) {
    mavlink_message_t message;
    for (uint32_t i = 0; i < MESSAGES_PER_POLL && channel_receive(channel, &message); i++) {
        dispatch(link, channel, &message);
        if (hal_time_us(link->hal) >= until_us) {
            return;
        }
    }
}

void link_poll(link_t *link, const link_status_t *status) {
    const uint64_t until_us = hal_time_us(link->hal) + LINK_POLL_US;
    link->status = status;
    for (uint32_t port = 0; port < LINK_PORTS; port++) {
        take_in(link, &link->channel[port], until_us);
    }
    set_ftp_conditions(link);
    link_telemetry(link);
    link_stream_params(link);
    link_stream_modes(link);
    stream_burst(link);
}
