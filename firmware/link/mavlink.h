/* The generated MAVLink headers, with the settings every user of them needs. */
#ifndef LINK_MAVLINK_H
#define LINK_MAVLINK_H

#include "tailbeat/mavlink.h"

#define LINK_SYSTEM 1u
#define LINK_COMPONENT MAV_COMP_ID_AUTOPILOT1

/* Compiled with the helpers, which declare it nowhere: link id, time and first 48 bits of the hash
 * into |signature|; the time moves on by one. */
uint8_t mavlink_sign_packet(mavlink_signing_t *signing,
                            uint8_t signature[MAVLINK_SIGNATURE_BLOCK_LEN], const uint8_t *header,
                            uint8_t header_len, const uint8_t *packet, uint8_t packet_len,
                            const uint8_t crc[2]);

#endif
