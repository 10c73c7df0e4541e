#include "imu/layout.h"

#define GROUPS 5u
#define KNOWN_GROUPS 0x17u
#define CRC_BYTES 2u

/* Bytes of each field; 0 = no such field. UM001 "Binary Output Message Configuration"; VpeStatus
 * and SyncInCnt of the Common group as recordings have them, the manual's summary misprints them.
 * All fields of all groups make 523 bytes, so no frame exceeds IMU_BINARY_MAX_BYTES. */
static const uint8_t field_bytes[GROUPS][16] = {
    [IMU_GROUP_COMMON] = {8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8},
    [IMU_GROUP_TIME] = {8, 8, 8, 2, 8, 8, 8, 4, 4, 1},
    [IMU_GROUP_IMU] = {2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2},
    [IMU_GROUP_ATTITUDE] = {2, 12, 16, 36, 12, 12, 12, 12, 12, 0, 0, 0, 12, 4},
};

static uint32_t load_word(const uint8_t *bytes) { return bytes[0] | (uint32_t)bytes[1] << 8; }

/* Of all |fields| of |group|; 0 when there is none or one is unknown. */
static uint32_t sum_bytes(unsigned group, uint32_t fields) {
    uint32_t sum = 0;
    for (; fields != 0; fields &= fields - 1u) {
        const uint32_t bytes = field_bytes[group][__builtin_ctz(fields)];
        if (bytes == 0) {
            return 0;
        }
        sum += bytes;
    }
    return sum;
}

imu_header_t imu_layout_header(const uint8_t *bytes, size_t held, uint16_t *frame_bytes) {
    if (held < 2) {
        return IMU_HEADER_CUT;
    }
    uint32_t groups = bytes[1];
    if (groups == 0 || (groups & ~KNOWN_GROUPS) != 0) {
        return IMU_HEADER_IMPOSSIBLE;
    }
    uint32_t header = 2, payload = 0;
    for (; groups != 0; groups &= groups - 1u) {
        if (held < header + 2u) {
            return IMU_HEADER_CUT;
        }
        const uint32_t sum = sum_bytes((unsigned)__builtin_ctz(groups), load_word(bytes + header));
        if (sum == 0) {
            return IMU_HEADER_IMPOSSIBLE;
        }
        header += 2;
        payload += sum;
    }
    *frame_bytes = (uint16_t)(header + payload + CRC_BYTES);
    return IMU_HEADER_COMPLETE;
}

bool imu_layout_field(const uint8_t *frame, imu_group_t group, unsigned bit, uint16_t *offset,
                      uint16_t *bytes) {
    const uint8_t *word = frame + 2;
    uint32_t begin = 2;
    for (uint32_t groups = frame[1]; groups != 0; groups &= groups - 1u) {
        begin += 2;
    }
    for (uint32_t groups = frame[1]; groups != 0; groups &= groups - 1u, word += 2) {
        const unsigned present = (unsigned)__builtin_ctz(groups);
        const uint32_t fields = load_word(word);
        if (present == (unsigned)group) {
            if (bit > 15u || (fields >> bit & 1u) == 0) {
                return false;
            }
            *offset = (uint16_t)(begin + sum_bytes(present, fields & ((1u << bit) - 1u)));
            *bytes = field_bytes[present][bit];
            return true;
        }
        begin += sum_bytes(present, fields);
    }
    return false;
}
