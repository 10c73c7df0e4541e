#include "link/identity.h"

#include "hal/system.h"
#include "link/build_id.h"
#include "link/metadata.h"

#include <string.h>

#define VERSION_0_1_0 0x00010000u /* major, minor, patch, type: development */
#define HASH_CHARS 8u
#define HASH_MIN_CHARS 7u

static bool is_hex(char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); }

/* The commit's hash is the first long run of hexadecimal digits in what git describe says. */
static const char *find_hash(const char *id) {
    for (const char *at = id; *at != '\0'; at++) {
        uint32_t run = 0;
        while (run < HASH_MIN_CHARS && is_hex(at[run])) {
            run++;
        }
        if (run == HASH_MIN_CHARS) {
            return at;
        }
    }
    return id;
}

static void copy_hash(uint8_t out[HASH_CHARS]) {
    const char *hash = find_hash(link_build_id());
    for (uint32_t i = 0; i < HASH_CHARS && hash[i] != '\0'; i++) {
        out[i] = (uint8_t)hash[i];
    }
}

/* As common ground stations can show it. Any other board sends 0. */
static uint16_t board_number(const char *name) {
    static const char *const known[] = {"fish", "simulated", "emulated"};
    uint16_t number = sizeof known / sizeof known[0];
    while (number > 0 && strcmp(name, known[number - 1u]) != 0) {
        number--;
    }
    return number;
}

void identity_version(const reports_t *reports, channel_t *channel) {
    hal_t *hal = reports->outbox->hal;
    const uint16_t board = board_number(hal_board_name(hal));
    uint8_t unique_id[16];
    char text[OUTBOX_TEXT_CHARS + 1] = "tailbeat ";
    mavlink_autopilot_version_t version = {
        .capabilities = MAV_PROTOCOL_CAPABILITY_FTP | MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST |
                        MAV_PROTOCOL_CAPABILITY_COMMAND_INT | MAV_PROTOCOL_CAPABILITY_MAVLINK2,
        .flight_sw_version = VERSION_0_1_0,
        .board_version = board,
        .product_id = board,
    };
    hal_unique_id(hal, unique_id);
    memcpy(version.uid2, unique_id, sizeof unique_id);
    memcpy(&version.uid, unique_id, sizeof version.uid);
    copy_hash(version.flight_custom_version);
    CHANNEL_SEND(channel, AUTOPILOT_VERSION, &version);
    strncat(text, link_build_id(), OUTBOX_TEXT_CHARS - strlen(text));
    outbox_text_to(channel, MAV_SEVERITY_INFO, text);
}

void identity_metadata(const reports_t *reports, channel_t *channel) {
    mavlink_component_metadata_t fields = {
        .time_boot_ms = outbox_boot_ms(reports->outbox),
        .file_crc = link_metadata_crc,
    };
    strcpy(fields.uri, "mftp://");
    strcat(fields.uri, link_metadata[0].path);
    CHANNEL_SEND(channel, COMPONENT_METADATA, &fields);
}
