#include "link/link.h"

#include "hal/clock.h"
#include "link/ftp_messages.h"
#include "link/host_messages.h"
#include "link/trust.h"

#include <string.h>

#define MESSAGES_PER_POLL 32u /* per port: more than the rings hold of all but the shortest */

static void give_outbox(link_t *link) {
    link->reports.outbox = &link->outbox;
    link->imu_stream.outbox = &link->outbox;
    link->discovery.outbox = &link->outbox;
    link->params_server.outbox = &link->outbox;
    link->commands.outbox = &link->outbox;
}

void link_init(link_t *link, hal_t *hal, store_t *store, params_t *params,
               const link_handlers_t *handlers) {
    memset(link, 0, sizeof *link);
    link->handlers = *handlers;
    give_outbox(link);
    link->reports.store = store;
    link->telemetry.reports = &link->reports;
    link->telemetry.params = params;
    link->params_server.params = params;
    link->params_server.handlers = &link->handlers;
    link->commands.handlers = &link->handlers;
    link->commands.ftp = &link->ftp;
    link->commands.requests.reports = &link->reports;
    link->commands.requests.telemetry = &link->telemetry;
    link->commands.requests.discovery = &link->discovery;
    link->commands.requests.imu_stream = &link->imu_stream;
    outbox_init(&link->outbox, hal);
    ftp_server_init(&link->ftp, store);
}

static void on_heartbeat(link_t *link, const received_t *in) {
    host_messages_on_heartbeat(&link->handlers, in);
}

static void on_timesync(link_t *link, const received_t *in) {
    host_messages_on_timesync(link->outbox.hal, in);
}

static void on_vision(link_t *link, const received_t *in) {
    host_messages_on_vision(&link->outbox, &link->handlers, in);
}

static void on_command_long(link_t *link, const received_t *in) {
    commands_on_long(&link->commands, in);
}

static void on_command_int(link_t *link, const received_t *in) {
    commands_on_int(&link->commands, in);
}

static void on_param_request_list(link_t *link, const received_t *in) {
    params_server_on_request_list(&link->params_server, in);
}

static void on_param_request_read(link_t *link, const received_t *in) {
    params_server_on_request_read(&link->params_server, in);
}

static void on_param_set(link_t *link, const received_t *in) {
    params_server_on_set(&link->params_server, in);
}

static void on_mission_request_list(link_t *link, const received_t *in) {
    (void)link;
    discovery_on_mission_request_list(in);
}

static void on_ftp(link_t *link, const received_t *in) {
    ftp_messages_on_request(&link->ftp, &link->outbox, in);
}

static void on_setup_signing(link_t *link, const received_t *in) {
    trust_on_setup_signing(&link->outbox, &link->handlers, in);
}

typedef struct {
    uint16_t message;
    bool refuses; /* has an answer for a wrong signature */
    void (*handle)(link_t *link, const received_t *in);
} route_t;

static const route_t routes[] = {
    {MAVLINK_MSG_ID_HEARTBEAT, false, on_heartbeat},
    {MAVLINK_MSG_ID_TIMESYNC, false, on_timesync},
    {MAVLINK_MSG_ID_VISION_SPEED_ESTIMATE, true, on_vision},
    {MAVLINK_MSG_ID_COMMAND_LONG, true, on_command_long},
    {MAVLINK_MSG_ID_COMMAND_INT, true, on_command_int},
    {MAVLINK_MSG_ID_PARAM_REQUEST_LIST, false, on_param_request_list},
    {MAVLINK_MSG_ID_PARAM_REQUEST_READ, false, on_param_request_read},
    {MAVLINK_MSG_ID_PARAM_SET, true, on_param_set},
    {MAVLINK_MSG_ID_MISSION_REQUEST_LIST, false, on_mission_request_list},
    {MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL, true, on_ftp},
    {MAVLINK_MSG_ID_SETUP_SIGNING, true, on_setup_signing},
};

static const route_t *find_route(uint32_t message) {
    for (uint32_t i = 0; i < sizeof routes / sizeof routes[0]; i++) {
        if (routes[i].message == message) {
            return &routes[i];
        }
    }
    return NULL;
}

/* While a trial's log is open only it may write flash. */
static void set_ftp_conditions(link_t *link) {
    const uint32_t open_trial = link->reports.status->open_trial;
    link->ftp.session.conditions = (ftp_conditions_t){
        .now_us = hal_time_us(link->outbox.hal),
        .read_only = open_trial != 0,
        .busy_trial = open_trial,
    };
}

static void dispatch(link_t *link, channel_t *channel, const mavlink_message_t *message) {
    /* A modem that echoes sends back what the board sent. */
    if (message->sysid == LINK_SYSTEM && message->compid == LINK_COMPONENT) {
        return;
    }
    outbox_t *outbox = &link->outbox;
    const uint64_t now_us = hal_time_us(outbox->hal);
    const received_t in = {channel, message, signing_check(&outbox->signing, message, now_us)};
    const bool wrong = in.verdict == SIGNING_WRONG;
    if (!wrong) {
        outbox_note_heard(outbox, channel, now_us);
    }
    const route_t *route = find_route(message->msgid);
    if (route != NULL && (!wrong || route->refuses)) {
        set_ftp_conditions(link);
        route->handle(link, &in);
    }
}

/* A list of files takes long to make, and a host may ask for many: the board has more to do. */
static void take_in(link_t *link, channel_t *channel, uint64_t until_us) {
    _Alignas(uint32_t) mavlink_message_t message; /* packed; its fields are read in place */
    for (uint32_t i = 0; i < MESSAGES_PER_POLL && channel_receive(channel, &message); i++) {
        dispatch(link, channel, &message);
        if (hal_time_us(link->outbox.hal) >= until_us) {
            return;
        }
    }
}

void link_poll(link_t *link, const link_status_t *status) {
    const uint64_t until_us = hal_time_us(link->outbox.hal) + LINK_POLL_US;
    link->reports.status = status;
    for (uint32_t port = 0; port < OUTBOX_PORTS; port++) {
        take_in(link, &link->outbox.channel[port], until_us);
    }
    set_ftp_conditions(link);
    telemetry_poll(&link->telemetry, ftp_messages_filled_port(&link->ftp));
    params_server_stream(&link->params_server);
    discovery_stream(&link->discovery);
    ftp_messages_stream(&link->ftp, &link->outbox);
}

void link_imu(link_t *link, const imu_sample_t *sample) {
    imu_stream_add(&link->imu_stream, sample);
}
