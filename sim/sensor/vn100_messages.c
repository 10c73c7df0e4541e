#include "vn100_messages.h"

#define FIRMWARE_NEWEST 3u
#define FRAME_EXTRA_BYTES 4u /* sync, groups, CRC */
#define LINE_EXTRA_BYTES 11u /* $VNxxx, *XX, CR, LF */

static const vn100_message_t ascii[] = {
    {1, 8, "YPR", "Y"},      {2, 9, "QTN", "Q"},       {8, 15, "QMR", "QMAG"},
    {10, 17, "MAG", "M"},    {11, 18, "ACC", "A"},     {12, 19, "GYR", "G"},
    {13, 20, "MAR", "MAG"},  {14, 27, "YMR", "YMAG"},  {16, 239, "YBA", "YLG"},
    {17, 240, "YIA", "YIG"}, {19, 54, "IMU", "MAGTP"}, {30, 80, "DTV", "D"},
};
#define ASCII (sizeof ascii / sizeof ascii[0])

const vn100_message_t *vn100_message(uint32_t type) {
    for (size_t i = 0; i < ASCII; i++) {
        if (ascii[i].type == type) {
            return &ascii[i];
        }
    }
    return NULL;
}

const vn100_message_t *vn100_message_of_register(unsigned id) {
    for (size_t i = 0; i < ASCII; i++) {
        if (ascii[i].register_id == id) {
            return &ascii[i];
        }
    }
    return NULL;
}

static size_t part_bytes(char part) {
    switch (part) {
    case 'Y':
    case 'M':
        return 27;
    case 'Q':
        return 40;
    case 'G':
        return 33;
    case 'T':
        return 6;
    case 'P':
        return 9;
    case 'D':
        return 61;
    default:
        return 24;
    }
}

size_t vn100_message_bytes(const vn100_message_t *message) {
    size_t sum = LINE_EXTRA_BYTES;
    for (const char *part = message->parts; *part != '\0'; part++) {
        sum += part_bytes(*part);
    }
    return sum;
}

/* Sizes of the fields of a group by bit; 0 = there is none. Some belong to the family's other
 * sensors and are zero here. */
static const uint8_t common_bytes[16] = {8, 8, 8, 12, 16, 12, 24, 12, 12, 24, 20, 28, 2, 4, 8};
static const uint8_t time_bytes[16] = {8, 8, 8, 2, 8, 8, 8, 4, 4, 1};
static const uint8_t imu_bytes[16] = {2, 12, 12, 12, 4, 4, 16, 12, 12, 12, 12, 2};
static const uint8_t attitude_bytes[16] = {2, 12, 16, 36, 12, 12, 12, 12, 12, 0, 0, 0, 12, 4};

static const uint8_t *group_bytes(unsigned group, unsigned firmware) {
    switch (group) {
    case 0:
        return common_bytes;
    case 1:
        return firmware >= 3 ? time_bytes : NULL;
    case 2:
        return imu_bytes;
    case 4:
        return attitude_bytes;
    default:
        return NULL;
    }
}

unsigned vn100_field_bytes(unsigned group, unsigned bit) {
    const uint8_t *sizes = group_bytes(group, FIRMWARE_NEWEST);
    return sizes != NULL ? sizes[bit] : 0;
}

static size_t fields_bytes(const uint8_t *sizes, uint32_t fields) {
    size_t sum = 0;
    for (unsigned bit = 0; bit < 16; bit++) {
        if (fields >> bit & 1u) {
            if (sizes[bit] == 0) {
                return 0;
            }
            sum += sizes[bit];
        }
    }
    return sum;
}

size_t vn100_binary_bytes(const vn100_binary_t *binary, unsigned firmware) {
    size_t sum = 0;
    for (unsigned group = 0; group < VN100_GROUPS; group++) {
        if ((binary->groups >> group & 1u) == 0) {
            continue;
        }
        const uint8_t *sizes = group_bytes(group, firmware);
        const size_t bytes = sizes != NULL ? fields_bytes(sizes, binary->fields[group]) : 0;
        if (bytes == 0 || binary->fields[group] > 0xFFFF) {
            return 0;
        }
        sum += 2 + bytes;
    }
    return sum != 0 ? sum + FRAME_EXTRA_BYTES : 0;
}
