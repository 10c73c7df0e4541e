/* What ground stations ask when they connect, and a fish answers in one line. */
#include "link/link_internal.h"

#include "base/units.h"
#include "hal/clock.h"
#include "link/metadata.h"

#include <string.h>

#define NOT_SELECTABLE 2u /* MAV_MODE_PROPERTY_NOT_USER_SELECTABLE */

void link_send_component_metadata(link_t *link, channel_t *channel) {
    mavlink_component_metadata_t fields = {
        .time_boot_ms = (uint32_t)units_thousandth(hal_time_us(link->hal)),
        .file_crc = link_metadata_crc,
    };
    strcpy(fields.uri, "mftp://");
    strcat(fields.uri, link_metadata[0].path);
    LINK_SEND(channel, COMPONENT_METADATA, &fields);
}

static void send_mode(channel_t *channel, uint32_t mode) {
    mavlink_available_modes_t fields = {
        .custom_mode = mode,
        .properties = NOT_SELECTABLE,
        .number_modes = STATE_COUNT,
        .mode_index = (uint8_t)(mode + 1u),
    };
    strcpy(fields.mode_name, state_name((state_t)mode));
    LINK_SEND(channel, AVAILABLE_MODES, &fields);
}

void link_request_modes(link_t *link, channel_t *channel, uint32_t index) {
    if (index == 0) {
        link->mode_stream_next[channel->port] = 0;
    } else {
        send_mode(channel, index - 1u);
    }
}

/* As the line has room: a station that asked for all waits for the last one without a time-out. */
void link_stream_modes(link_t *link) {
    const size_t needed = LINK_FRAME_BYTES + MAVLINK_MSG_ID_AVAILABLE_MODES_LEN;
    for (uint32_t i = 0; i < LINK_PORTS; i++) {
        uint8_t *next = &link->mode_stream_next[i];
        while (*next < STATE_COUNT && channel_has_space(&link->channel[i], needed)) {
            send_mode(&link->channel[i], (*next)++);
        }
    }
}

/* The fish has no waypoints, no fence and no rally points; a station that hears nothing retries for
 * seconds. */
void link_on_mission_request_list(link_t *link, const link_received_t *in) {
    mavlink_mission_request_list_t request;
    mavlink_msg_mission_request_list_decode(in->message, &request);
    (void)link;
    if (!link_addressed(request.target_system, request.target_component)) {
        return;
    }
    const mavlink_mission_count_t fields = {
        .count = 0,
        .target_system = in->message->sysid,
        .target_component = in->message->compid,
        .mission_type = request.mission_type,
    };
    LINK_SEND(in->channel, MISSION_COUNT, &fields);
}
