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

void link_send_modes(channel_t *channel, uint32_t index) {
    const uint32_t first = index == 0 ? 0 : index - 1u;
    const uint32_t end = index == 0 ? STATE_COUNT : index;
    for (uint32_t mode = first; mode < end; mode++) {
        send_mode(channel, mode);
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
