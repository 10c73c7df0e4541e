/* Checksums. Pure functions, no tables in RAM, callable from interrupts. */
#ifndef BASE_CRC_H
#define BASE_CRC_H

#include <stddef.h>
#include <stdint.h>

/* CRC-32 of MAVLink FTP: reflected polynomial 0xEDB88320, no final inversion. Start with |crc| = 0;
 * feed the result back in to go on over the next piece. crc32_update(0, "123456789", 9) =
 * 0x2DFD2D88. Not zlib's: that one starts with and ends by inverting all bits. */
uint32_t crc32_update(uint32_t crc, const void *bytes, size_t length);

/* CRC-16/XMODEM of the VN-100 (polynomial 0x1021, start 0). "123456789" gives 0x31C3; running it on
 * over a frame's two CRC bytes gives 0. */
uint16_t crc16_update(uint16_t crc, const void *bytes, size_t length);

#if !(defined(__ARM_ARCH_PROFILE) && __ARM_ARCH_PROFILE == 'M')
/* The change of MAVLink's CRC-16/MCRF4XX by a byte; not on the board, whose flash is short. */
#define CRC_MCRF4XX_TABLE
extern const uint16_t crc_mcrf4xx_byte[256];

/* CRC-16/MCRF4XX, of a MAVLink frame. Start with |crc| = 0xFFFF; "123456789" gives 0x6F91. */
uint16_t crc_mcrf4xx_update(uint16_t crc, const void *bytes, size_t length);
#endif

#endif
