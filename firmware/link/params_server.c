#include "link/link_internal.h"

#include "base/real.h"

#include <string.h>

#define PARAMS_PER_POLL 8u
#define IS_NOW " is now "

static void put_name(param_t param, char out[PARAM_NAME_BYTES]) {
    const char *name = param_info(param)->name;
    for (uint32_t i = 0; i < PARAM_NAME_BYTES && name[i] != '\0'; i++) {
        out[i] = name[i];
    }
}

static void send_value(const link_t *link, channel_t *channel, param_t param) {
    mavlink_param_value_t fields = {
        .param_value = link->params->value[param],
        .param_count = PARAM_COUNT,
        .param_index = (uint16_t)param,
        .param_type = MAV_PARAM_TYPE_REAL32,
    };
    put_name(param, fields.param_id);
    LINK_SEND(channel, PARAM_VALUE, &fields);
}

/* Which parameter a host spoke of, as it named it. */
typedef struct {
    char name[PARAM_NAME_BYTES];
    int16_t index;
} named_t;

static void send_error(const link_received_t *in, const named_t *named, uint8_t error) {
    mavlink_param_error_t fields = {
        .param_index = named->index,
        .target_system = in->message->sysid,
        .target_component = in->message->compid,
        .error = error,
    };
    memcpy(fields.param_id, named->name, sizeof fields.param_id);
    LINK_SEND(in->channel, PARAM_ERROR, &fields);
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
    link_send_text(channel, MAV_SEVERITY_WARNING, text);
    return true;
}

void link_on_param_request_list(link_t *link, const link_received_t *in) {
    mavlink_param_request_list_t request;
    mavlink_msg_param_request_list_decode(in->message, &request);
    if (link_addressed(request.target_system, request.target_component)) {
        link->param_stream_next[in->channel->port] = 0;
    }
}

static void stream_to(link_t *link, channel_t *channel) {
    const size_t needed = LINK_FRAME_BYTES + MAVLINK_MSG_ID_PARAM_VALUE_LEN + LINK_RESERVE_BYTES;
    uint16_t *next = &link->param_stream_next[channel->port];
    for (uint32_t i = 0; i < PARAMS_PER_POLL; i++) {
        if (*next >= PARAM_COUNT || !channel_has_space(channel, needed)) {
            return;
        }
        send_value(link, channel, (param_t)*next);
        (*next)++;
    }
}

void link_stream_params(link_t *link) {
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        stream_to(link, &link->channel[i]);
    }
}

void link_on_param_request_read(link_t *link, const link_received_t *in) {
    mavlink_param_request_read_t request;
    mavlink_msg_param_request_read_decode(in->message, &request);
    if (!link_addressed(request.target_system, request.target_component)) {
        return;
    }
    const bool by_name = request.param_index == -1;
    const int32_t param =
        by_name ? (int32_t)param_find(request.param_id) : (int32_t)request.param_index;
    if (param >= 0 && param < (int32_t)PARAM_COUNT) {
        send_value(link, in->channel, (param_t)param);
        return;
    }
    named_t named = {.index = request.param_index};
    memcpy(named.name, request.param_id, sizeof named.name);
    send_error(in, &named, MAV_PARAM_ERROR_DOES_NOT_EXIST);
    if (by_name) {
        (void)send_new_name(in->channel, request.param_id);
    }
}

static uint8_t param_error(fault_t fault) {
    return fault == FAULT_WRONG_STATE ? MAV_PARAM_ERROR_PERMISSION_DENIED
                                      : MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE;
}

/* A new value concerns every host. */
static void announce(link_t *link, param_t param) {
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        if (link_heard(link, &link->channel[i])) {
            send_value(link, &link->channel[i], param);
        }
    }
}

void link_on_param_set(link_t *link, const link_received_t *in) {
    mavlink_param_set_t request;
    mavlink_msg_param_set_decode(in->message, &request);
    if (!link_addressed(request.target_system, request.target_component)) {
        return;
    }
    named_t named = {.index = -1};
    memcpy(named.name, request.param_id, sizeof named.name);
    if (link_refusal(link, in) != FAULT_NONE) {
        send_error(in, &named, MAV_PARAM_ERROR_PERMISSION_DENIED);
        return;
    }
    const param_t param = param_find(request.param_id);
    if (param == PARAM_COUNT) {
        send_error(in, &named, MAV_PARAM_ERROR_DOES_NOT_EXIST);
        if (!send_new_name(in->channel, request.param_id)) {
            link_send_text(in->channel, MAV_SEVERITY_WARNING, fault_info(FAULT_BAD_PARAM)->meaning);
        }
        return;
    }
    fault_t fault = FAULT_BAD_PARAM;
    if (real_is_finite(request.param_value)) {
        fault = link->handlers.param_set(link->handlers.context, param, request.param_value);
    }
    if (fault == FAULT_NONE) {
        announce(link, param);
        return;
    }
    send_error(in, &named, param_error(fault));
    send_value(link, in->channel, param);
    link_send_text(in->channel, MAV_SEVERITY_WARNING, fault_info(fault)->meaning);
}
