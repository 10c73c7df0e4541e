#include "link/params_server.h"

#include "base/real.h"
#include "link/trust.h"

#include <string.h>

#define PARAMS_PER_POLL 8u
#define IS_NOW " is now "

static void put_name(param_t param, char out[PARAM_NAME_BYTES]) {
    const char *name = param_info(param)->name;
    for (uint32_t i = 0; i < PARAM_NAME_BYTES && name[i] != '\0'; i++) {
        out[i] = name[i];
    }
}

static mavlink_param_value_t value_of(const params_server_t *server, param_t param) {
    mavlink_param_value_t fields = {
        .param_value = server->params->value[param],
        .param_count = PARAM_COUNT,
        .param_index = (uint16_t)param,
        .param_type = MAV_PARAM_TYPE_REAL32,
    };
    put_name(param, fields.param_id);
    return fields;
}

static void send_value(const params_server_t *server, channel_t *channel, param_t param) {
    const mavlink_param_value_t fields = value_of(server, param);
    CHANNEL_SEND(channel, PARAM_VALUE, &fields);
}

/* A new value concerns every host. */
static void announce(const params_server_t *server, param_t param) {
    const mavlink_param_value_t fields = value_of(server, param);
    OUTBOX_SEND(server->outbox, PARAM_VALUE, &fields);
}

/* Which parameter a host spoke of, as it named it. */
typedef struct {
    char name[PARAM_NAME_BYTES];
    int16_t index;
} named_t;

static void send_error(const received_t *in, const named_t *named, uint8_t error) {
    mavlink_param_error_t fields = {
        .param_index = named->index,
        .target_system = in->message->sysid,
        .target_component = in->message->compid,
        .error = error,
    };
    memcpy(fields.param_id, named->name, sizeof fields.param_id);
    CHANNEL_SEND(in->channel, PARAM_ERROR, &fields);
}

/* An old name is refused with the new one: "LAW_GAIN is now ILC_GAIN". */
static bool send_new_name(channel_t *channel, const char old_name[PARAM_NAME_BYTES]) {
    const param_t param = param_find_renamed(old_name);
    if (param == PARAM_COUNT) {
        return false;
    }
    char text[2u * PARAM_NAME_BYTES + sizeof IS_NOW] = {0};
    strncat(text, old_name, PARAM_NAME_BYTES);
    strcat(text, IS_NOW);
    strncat(text, param_info(param)->name, PARAM_NAME_BYTES);
    outbox_text_to(channel, MAV_SEVERITY_WARNING, text);
    return true;
}

void params_server_on_request_list(params_server_t *server, const received_t *in) {
    const mavlink_message_t *message = in->message;
    if (received_is_ours(mavlink_msg_param_request_list_get_target_system(message),
                         mavlink_msg_param_request_list_get_target_component(message))) {
        server->left[in->channel->port] = PARAM_COUNT;
    }
}

static void stream_to(params_server_t *server, channel_t *channel) {
    const size_t needed =
        CHANNEL_FRAME_BYTES + MAVLINK_MSG_ID_PARAM_VALUE_LEN + CHANNEL_RESERVE_BYTES;
    uint16_t *left = &server->left[channel->port];
    for (uint32_t i = 0; i < PARAMS_PER_POLL; i++) {
        if (*left == 0 || !channel_has_space(channel, needed)) {
            return;
        }
        send_value(server, channel, (param_t)(PARAM_COUNT - *left));
        (*left)--;
    }
}

void params_server_stream(params_server_t *server) {
    for (uint32_t i = 0; i < OUTBOX_PORTS; i++) {
        stream_to(server, &server->outbox->channel[i]);
    }
}

void params_server_on_request_read(const params_server_t *server, const received_t *in) {
    const mavlink_message_t *message = in->message;
    if (!received_is_ours(mavlink_msg_param_request_read_get_target_system(message),
                          mavlink_msg_param_request_read_get_target_component(message))) {
        return;
    }
    named_t named = {.index = mavlink_msg_param_request_read_get_param_index(message)};
    (void)mavlink_msg_param_request_read_get_param_id(message, named.name);
    const bool by_name = named.index == -1;
    const int32_t param = by_name ? (int32_t)param_find(named.name) : (int32_t)named.index;
    if (param >= 0 && param < (int32_t)PARAM_COUNT) {
        send_value(server, in->channel, (param_t)param);
        return;
    }
    send_error(in, &named, MAV_PARAM_ERROR_DOES_NOT_EXIST);
    if (by_name) {
        (void)send_new_name(in->channel, named.name);
    }
}

static uint8_t param_error(fault_t fault) {
    return fault == FAULT_WRONG_STATE ? MAV_PARAM_ERROR_PERMISSION_DENIED
                                      : MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE;
}

/* Asks the application; a value that is not finite is refused without it. */
static fault_t set_value(const params_server_t *server, param_t param, float value) {
    const link_handlers_t *handlers = server->handlers;
    return real_is_finite(value) ? handlers->param_set(handlers->context, param, value)
                                 : FAULT_BAD_PARAM;
}

static void set(const params_server_t *server, const received_t *in, const named_t *named) {
    const param_t param = param_find(named->name);
    if (param == PARAM_COUNT) {
        send_error(in, named, MAV_PARAM_ERROR_DOES_NOT_EXIST);
        if (!send_new_name(in->channel, named->name)) {
            outbox_warn(in->channel, FAULT_BAD_PARAM);
        }
        return;
    }
    const fault_t fault =
        set_value(server, param, mavlink_msg_param_set_get_param_value(in->message));
    if (fault == FAULT_NONE) {
        announce(server, param);
        return;
    }
    send_error(in, named, param_error(fault));
    send_value(server, in->channel, param);
    outbox_warn(in->channel, fault);
}

void params_server_on_set(const params_server_t *server, const received_t *in) {
    const mavlink_message_t *message = in->message;
    if (!received_is_ours(mavlink_msg_param_set_get_target_system(message),
                          mavlink_msg_param_set_get_target_component(message))) {
        return;
    }
    named_t named = {.index = -1};
    (void)mavlink_msg_param_set_get_param_id(message, named.name);
    if (trust_refusal(server->outbox, in) != FAULT_NONE) {
        send_error(in, &named, MAV_PARAM_ERROR_PERMISSION_DENIED);
    } else {
        set(server, in, &named);
    }
}
