/* The generated MAVLink headers, with the settings every user of them needs. */
#ifndef LINK_MAVLINK_H
#define LINK_MAVLINK_H

#include "base/crc.h"

#ifdef CRC_MCRF4XX_TABLE
#define HAVE_CRC_ACCUMULATE
/* In place of the headers' own, which takes three times as many instructions. */
static inline void crc_accumulate(uint8_t byte, uint16_t *sum) {
    *sum = (uint16_t)(*sum >> 8 ^ crc_mcrf4xx_byte[(*sum ^ byte) & 0xFFu]);
}
#endif

#include "tailbeat/mavlink.h"

#define LINK_SYSTEM 1u
#define LINK_COMPONENT MAV_COMP_ID_AUTOPILOT1

/* What framing needs to know of a message. */
typedef struct {
    uint32_t id;
    uint8_t min_bytes; /* of the payload, without extension fields: the length in MAVLink 1 */
    uint8_t max_bytes;
    uint8_t crc_extra;
} message_form_t;

#define MESSAGE_FORM(NAME)                                                                         \
    {                                                                                              \
        MAVLINK_MSG_ID_##NAME, MAVLINK_MSG_ID_##NAME##_MIN_LEN, MAVLINK_MSG_ID_##NAME##_LEN,       \
            MAVLINK_MSG_ID_##NAME##_CRC                                                            \
    }

/* Compiled with the helpers, which declare it nowhere: link id, time and first 48 bits of the hash
 * into |signature|; the time moves on by one. */
uint8_t mavlink_sign_packet(mavlink_signing_t *signing,
                            uint8_t signature[MAVLINK_SIGNATURE_BLOCK_LEN], const uint8_t *header,
                            uint8_t header_len, const uint8_t *packet, uint8_t packet_len,
                            const uint8_t crc[2]);

#endif
