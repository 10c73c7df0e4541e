#include "link/discovery.h"

#include "supervisor/supervisor.h"

#include <string.h>

#define NOT_SELECTABLE 2u /* MAV_MODE_PROPERTY_NOT_USER_SELECTABLE */

static void send_mode(channel_t *channel, uint32_t mode) {
    mavlink_available_modes_t fields = {
        .custom_mode = mode,
        .properties = NOT_SELECTABLE,
        .number_modes = STATE_COUNT,
        .mode_index = (uint8_t)(mode + 1u),
    };
    strcpy(fields.mode_name, state_name((state_t)mode));
    CHANNEL_SEND(channel, AVAILABLE_MODES, &fields);
}

void discovery_send_modes(discovery_t *discovery, channel_t *channel, uint32_t index) {
    if (index == 0) {
        discovery->modes_left[channel->port] = STATE_COUNT;
    } else {
        send_mode(channel, index - 1u);
    }
}

/* As the line has room: a station that asked for all waits for the last one without a time-out. */
void discovery_stream(discovery_t *discovery) {
    const size_t needed = CHANNEL_FRAME_BYTES + MAVLINK_MSG_ID_AVAILABLE_MODES_LEN;
    for (uint32_t i = 0; i < OUTBOX_PORTS; i++) {
        channel_t *channel = &discovery->outbox->channel[i];
        uint8_t *left = &discovery->modes_left[i];
        for (; *left > 0 && channel_has_space(channel, needed); (*left)--) {
            send_mode(channel, STATE_COUNT - *left);
        }
    }
}

/* The fish has no waypoints, no fence and no rally points; a station that hears nothing retries for
 * seconds. */
void discovery_on_mission_request_list(const received_t *in) {
    const mavlink_message_t *message = in->message;
    if (!received_is_ours(mavlink_msg_mission_request_list_get_target_system(message),
                          mavlink_msg_mission_request_list_get_target_component(message))) {
        return;
    }
    const mavlink_mission_count_t fields = {
        .count = 0,
        .target_system = message->sysid,
        .target_component = message->compid,
        .mission_type = mavlink_msg_mission_request_list_get_mission_type(message),
    };
    CHANNEL_SEND(in->channel, MISSION_COUNT, &fields);
}
