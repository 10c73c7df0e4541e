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
        link->param_stream_next[i] = PARAM_COUNT;
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

static void on_heartbeat(link_t *link, const link_received_t *in) {
    if (mavlink_msg_heartbeat_get_type(in->message) != MAV_TYPE_SUBMARINE) {
        link->handlers.heartbeat(link->handlers.context, in->channel->port, in->message->sysid,
                                 in->message->compid);
    }
}

/* A request has tc1 = 0; what else comes is the answer to somebody's request. */
static void on_timesync(link_t *link, const link_received_t *in) {
    mavlink_timesync_t sync;
    mavlink_message_t message;
    mavlink_msg_timesync_decode(in->message, &sync);
    if (sync.tc1 != 0) {
        return;
    }
    sync.tc1 = (int64_t)(hal_time_us(link->hal) * 1000u);
    mavlink_msg_timesync_encode_status(LINK_SYSTEM, LINK_COMPONENT, &in->channel->tx_status,
                                       &message, &sync);
    (void)channel_send(in->channel, &message);
}

/* A variance of 0 is a field that was left out: MAVLink 1, or zeros cut off the end. */
static float sigma_of(float variance) {
    return real_is_finite(variance) && variance > 0.0f ? real_sqrt(variance) : NAN;
}

static void on_vision(link_t *link, const link_received_t *in) {
    mavlink_vision_speed_estimate_t estimate;
    mavlink_msg_vision_speed_estimate_decode(in->message, &estimate);
    const link_vision_t sample = {
        .time_us = estimate.usec,
        .speed_m_s = estimate.x,
        .sigma_m_s = sigma_of(estimate.covariance[0]),
    };
    link->handlers.vision(link->handlers.context, &sample);
}

static void send_ftp(channel_t *channel, ftp_host_t host, const uint8_t *payload) {
    mavlink_message_t message;
    mavlink_msg_file_transfer_protocol_pack_status(LINK_SYSTEM, LINK_COMPONENT, &channel->tx_status,
                                                   &message, 0, host.system, host.component,
                                                   payload);
    (void)channel_send(channel, &message);
}

static void on_ftp(link_t *link, const link_received_t *in) {
    mavlink_file_transfer_protocol_t request;
    uint8_t reply[FTP_PAYLOAD_BYTES];
    mavlink_msg_file_transfer_protocol_decode(in->message, &request);
    if (!link_addressed(request.target_system, request.target_component)) {
        return;
    }
    const ftp_host_t host = {in->message->sysid, in->message->compid, (uint8_t)in->channel->port};
    if (ftp_server_request(&link->ftp, host, request.payload, reply)) {
        send_ftp(in->channel, host, reply);
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
    uint8_t reply[FTP_PAYLOAD_BYTES];
    for (uint32_t i = 0; i < BURST_PACKETS_PER_POLL && channel_has_space(channel, needed); i++) {
        if (!ftp_server_burst(&link->ftp, reply)) {
            return;
        }
        send_ftp(channel, link->ftp.owner, reply);
    }
}

typedef struct {
    uint32_t message;
    void (*handle)(link_t *link, const link_received_t *in);
} route_t;

static const route_t routes[] = {
    {MAVLINK_MSG_ID_HEARTBEAT, on_heartbeat},
    {MAVLINK_MSG_ID_TIMESYNC, on_timesync},
    {MAVLINK_MSG_ID_VISION_SPEED_ESTIMATE, on_vision},
    {MAVLINK_MSG_ID_COMMAND_LONG, link_on_command_long},
    {MAVLINK_MSG_ID_COMMAND_INT, link_on_command_int},
    {MAVLINK_MSG_ID_PARAM_REQUEST_LIST, link_on_param_request_list},
    {MAVLINK_MSG_ID_PARAM_REQUEST_READ, link_on_param_request_read},
    {MAVLINK_MSG_ID_PARAM_SET, link_on_param_set},
    {MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL, on_ftp},
};

static void dispatch(link_t *link, const link_received_t *in) {
    /* Our own words come back from a modem that echoes. */
    if (in->message->sysid == LINK_SYSTEM && in->message->compid == LINK_COMPONENT) {
        return;
    }
    link->heard_until_us[in->channel->port] = hal_time_us(link->hal) + LINK_HEARD_US;
    for (uint32_t i = 0; i < sizeof routes / sizeof routes[0]; i++) {
        if (routes[i].message == in->message->msgid) {
            set_ftp_conditions(link);
            routes[i].handle(link, in);
            return;
        }
    }
}

void link_poll(link_t *link, const link_status_t *status) {
    link->status = status;
    for (uint32_t port = 0; port < LINK_PORTS; port++) {
        mavlink_message_t message;
        const link_received_t in = {&link->channel[port], &message};
        for (uint32_t i = 0; i < MESSAGES_PER_POLL && channel_receive(in.channel, &message); i++) {
            dispatch(link, &in);
        }
    }
    set_ftp_conditions(link);
    link_telemetry(link);
    link_stream_params(link);
    stream_burst(link);
}
