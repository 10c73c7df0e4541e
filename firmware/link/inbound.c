#include "link/inbound.h"

#include <stddef.h>

static const message_form_t forms[] = {
    MESSAGE_FORM(HEARTBEAT),
    MESSAGE_FORM(TIMESYNC),
    MESSAGE_FORM(VISION_SPEED_ESTIMATE),
    MESSAGE_FORM(COMMAND_LONG),
    MESSAGE_FORM(COMMAND_INT),
    MESSAGE_FORM(PARAM_REQUEST_LIST),
    MESSAGE_FORM(PARAM_REQUEST_READ),
    MESSAGE_FORM(PARAM_SET),
    MESSAGE_FORM(MISSION_REQUEST_LIST),
    MESSAGE_FORM(FILE_TRANSFER_PROTOCOL),
    MESSAGE_FORM(SETUP_SIGNING),
};

const message_form_t *inbound_form(uint32_t id) {
    for (size_t i = 0; i < sizeof forms / sizeof forms[0]; i++) {
        if (forms[i].id == id) {
            return &forms[i];
        }
    }
    return NULL;
}
