#include "vn100_output.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#define DEG (3.14159265358979323846 / 180)

static void add_values(vn100_text_t *out, const char *format, const double *value, unsigned count) {
    for (unsigned i = 0; i < count; i++) {
        vn100_text_add(out, format, value[i]);
    }
}

static void quaternion_of(const double ypr_deg[3], double q[4]) {
    const double y = 0.5 * DEG * ypr_deg[0];
    const double p = 0.5 * DEG * ypr_deg[1];
    const double r = 0.5 * DEG * ypr_deg[2];
    q[0] = sin(r) * cos(p) * cos(y) - cos(r) * sin(p) * sin(y);
    q[1] = cos(r) * sin(p) * cos(y) + sin(r) * cos(p) * sin(y);
    q[2] = cos(r) * cos(p) * sin(y) - sin(r) * sin(p) * cos(y);
    q[3] = cos(r) * cos(p) * cos(y) + sin(r) * sin(p) * sin(y);
}

static void add_part(char part, const vn100_sense_t *sense, vn100_text_t *out) {
    const vn100_sample_t *sample = &sense->last;
    const double none[3] = {0};
    double quaternion[4];
    vn100_surroundings_t around;
    switch (part) {
    case 'Y':
        add_values(out, ",%+08.3f", sample->ypr_deg, 3);
        break;
    case 'Q':
        quaternion_of(sample->ypr_deg, quaternion);
        add_values(out, ",%+09.6f", quaternion, 4);
        break;
    case 'M':
        vn100_surroundings(sense, &around);
        add_values(out, ",%+08.4f", around.mag_gauss, 3);
        break;
    case 'A':
        add_values(out, ",%+07.3f", sample->accel_m_s2, 3);
        break;
    case 'L':
        add_values(out, ",%+07.3f", sample->linear_m_s2, 3);
        break;
    case 'I':
        add_values(out, ",%+07.3f", sample->linear_ned_m_s2, 3);
        break;
    case 'G':
        add_values(out, ",%+010.6f", sample->rate_rad_s, 3);
        break;
    case 'T':
        vn100_surroundings(sense, &around);
        add_values(out, ",%+05.1f", &around.temperature_c, 1);
        break;
    case 'P':
        vn100_surroundings(sense, &around);
        add_values(out, ",%+08.3f", &around.pressure_kpa, 1);
        break;
    default:
        add_values(out, ",%+09.6f", none, 1);
        add_values(out, ",%+08.3f", none, 3);
        add_values(out, ",%+07.3f", none, 3);
    }
}

/* Without pulses on its SyncIn pin the sensor's time since the last one stays near 12 ms. */
static void add_count_and_status(const vn100_settings_t *settings, const vn100_sense_t *sense,
                                 vn100_text_t *out) {
    const double *control = vn100_setting(settings, 30);
    const double *count = vn100_setting(settings, 33);
    if (control[0] != 0) {
        vn100_text_add(out, settings->firmware == 2 ? ",T%07.0f" : ",T%010.0f",
                       count[(unsigned)control[0] - 1]);
    }
    if (control[1] != 0) {
        vn100_surroundings_t around;
        vn100_surroundings(sense, &around);
        vn100_text_add(out, ",S%04X", (unsigned)around.vpe_status);
    }
}

void vn100_ascii(const vn100_settings_t *settings, uint32_t type, const vn100_sense_t *sense,
                 vn100_text_t *out) {
    const vn100_message_t *message = vn100_message(type);
    vn100_text_add(out, "VN%s", message->name);
    for (const char *part = message->parts; *part != '\0'; part++) {
        add_part(*part, sense, out);
    }
    add_count_and_status(settings, sense, out);
}

bool vn100_measured(unsigned id, const vn100_sense_t *sense, vn100_text_t *out) {
    const vn100_message_t *message = vn100_message_of_register(id);
    for (const char *part = message != NULL ? message->parts : ""; *part != '\0'; part++) {
        add_part(*part, sense, out);
    }
    return message != NULL;
}

static uint8_t *put16(uint8_t *at, uint16_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    return at + 2;
}

static uint8_t *put32(uint8_t *at, uint32_t value) {
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
    at[2] = (uint8_t)(value >> 16);
    at[3] = (uint8_t)(value >> 24);
    return at + 4;
}

static uint8_t *put64(uint8_t *at, uint64_t value) {
    return put32(put32(at, (uint32_t)value), (uint32_t)(value >> 32));
}

static uint8_t *put_real(uint8_t *at, double value) {
    const float single = (float)value;
    uint32_t word;
    memcpy(&word, &single, sizeof word);
    return put32(at, word);
}

static uint8_t *put_three(uint8_t *at, const double value[3]) {
    return put_real(put_real(put_real(at, value[0]), value[1]), value[2]);
}

static uint8_t *put_zeros(uint8_t *at, unsigned bytes) {
    memset(at, 0, bytes);
    return at + bytes;
}

static uint8_t *put_quaternion(uint8_t *at, const vn100_sense_t *sense) {
    double quaternion[4];
    quaternion_of(sense->last.ypr_deg, quaternion);
    return put_real(put_three(at, quaternion), quaternion[3]);
}

/* Parts of what is around: field, temperature, pressure. */
static uint8_t *put_around(uint8_t *at, const vn100_sense_t *sense, const char *parts) {
    vn100_surroundings_t around;
    vn100_surroundings(sense, &around);
    for (; *parts != '\0'; parts++) {
        at = *parts == 'M'   ? put_three(at, around.mag_gauss)
             : *parts == 'T' ? put_real(at, around.temperature_c)
             : *parts == 'P' ? put_real(at, around.pressure_kpa)
                             : put16(at, around.vpe_status);
    }
    return at;
}

static uint8_t *put_common(uint8_t *at, unsigned bit, const vn100_sense_t *sense,
                           uint64_t stamp_ns) {
    const vn100_sample_t *sample = &sense->last;
    switch (bit) {
    case 0:
        return put64(at, stamp_ns);
    case 3:
        return put_three(at, sample->ypr_deg);
    case 4:
        return put_quaternion(at, sense);
    case 5:
        return put_three(at, sample->rate_rad_s);
    case 8:
        return put_three(at, sample->accel_m_s2);
    case 9: /* the manual has it the other way round; 3,397 recorded frames have not */
        return put_three(put_three(at, sample->accel_m_s2), sample->rate_rad_s);
    case 10:
        return put_around(at, sense, "MTP");
    case 12:
        return put_around(at, sense, "S");
    default:
        return put_zeros(at, vn100_field_bytes(0, bit));
    }
}

static uint8_t *put_imu(uint8_t *at, unsigned bit, const vn100_sense_t *sense) {
    switch (bit) {
    case 1:
    case 8:
        return put_around(at, sense, "M");
    case 2:
    case 9:
        return put_three(at, sense->last.accel_m_s2);
    case 3:
    case 10:
        return put_three(at, sense->last.rate_rad_s);
    case 4:
        return put_around(at, sense, "T");
    case 5:
        return put_around(at, sense, "P");
    default:
        return put_zeros(at, vn100_field_bytes(2, bit));
    }
}

static uint8_t *put_attitude(uint8_t *at, unsigned bit, const vn100_sense_t *sense) {
    switch (bit) {
    case 0:
        return put_around(at, sense, "S");
    case 1:
        return put_three(at, sense->last.ypr_deg);
    case 2:
        return put_quaternion(at, sense);
    case 6:
        return put_three(at, sense->last.linear_m_s2);
    case 7:
        return put_three(at, sense->last.linear_ned_m_s2);
    default:
        return put_zeros(at, vn100_field_bytes(4, bit));
    }
}

static uint8_t *put_field(uint8_t *at, unsigned group, unsigned bit, const vn100_sense_t *sense,
                          uint64_t stamp_ns) {
    switch (group) {
    case 0:
        return put_common(at, bit, sense, stamp_ns);
    case 1:
        return bit == 0 ? put64(at, stamp_ns) : put_zeros(at, vn100_field_bytes(1, bit));
    case 2:
        return put_imu(at, bit, sense);
    default:
        return put_attitude(at, bit, sense);
    }
}

/* CRC-16/XMODEM, written apart from the firmware's so that neither can hide the other's mistake:
 * with tables, eight bytes at a time, because every frame of a simulated trial needs it. The sum of
 * a byte is the sum of those of its bits, so a table follows from eight entries. */
#define XOR1(x, a) (x), (x) ^ (a)
#define XOR2(x, a, b) XOR1(x, a), XOR1((x) ^ (b), a)
#define XOR3(x, a, b, c) XOR2(x, a, b), XOR2((x) ^ (c), a, b)
#define XOR4(x, a, b, c, d) XOR3(x, a, b, c), XOR3((x) ^ (d), a, b, c)
#define XOR5(x, a, b, c, d, e) XOR4(x, a, b, c, d), XOR4((x) ^ (e), a, b, c, d)
#define XOR6(x, a, b, c, d, e, f) XOR5(x, a, b, c, d, e), XOR5((x) ^ (f), a, b, c, d, e)
#define XOR7(x, a, b, c, d, e, f, g) XOR6(x, a, b, c, d, e, f), XOR6((x) ^ (g), a, b, c, d, e, f)
#define XOR8(x, a, b, c, d, e, f, g, h)                                                            \
    XOR7(x, a, b, c, d, e, f, g), XOR7((x) ^ (h), a, b, c, d, e, f, g)

/* [k]: a byte with k bytes behind it. */
static const uint16_t xmodem_byte[8][256] = {
    {XOR8(0, 0x1021, 0x2042, 0x4084, 0x8108, 0x1231, 0x2462, 0x48C4, 0x9188)},
    {XOR8(0, 0x3331, 0x6662, 0xCCC4, 0x89A9, 0x0373, 0x06E6, 0x0DCC, 0x1B98)},
    {XOR8(0, 0x3730, 0x6E60, 0xDCC0, 0xA9A1, 0x4363, 0x86C6, 0x1DAD, 0x3B5A)},
    {XOR8(0, 0x76B4, 0xED68, 0xCAF1, 0x85C3, 0x1BA7, 0x374E, 0x6E9C, 0xDD38)},
    {XOR8(0, 0xAA51, 0x4483, 0x8906, 0x022D, 0x045A, 0x08B4, 0x1168, 0x22D0)},
    {XOR8(0, 0x45A0, 0x8B40, 0x06A1, 0x0D42, 0x1A84, 0x3508, 0x6A10, 0xD420)},
    {XOR8(0, 0xB861, 0x60E3, 0xC1C6, 0x93AD, 0x377B, 0x6EF6, 0xDDEC, 0xABF9)},
    {XOR8(0, 0x47D3, 0x8FA6, 0x0F6D, 0x1EDA, 0x3DB4, 0x7B68, 0xF6D0, 0xFD81)},
};

static uint16_t crc_xmodem(const uint8_t *bytes, size_t length) {
    unsigned crc = 0;
    for (; length >= 8; length -= 8, bytes += 8) {
        crc = xmodem_byte[7][bytes[0] ^ crc >> 8] ^ xmodem_byte[6][bytes[1] ^ (crc & 0xFFu)] ^
              xmodem_byte[5][bytes[2]] ^ xmodem_byte[4][bytes[3]] ^ xmodem_byte[3][bytes[4]] ^
              xmodem_byte[2][bytes[5]] ^ xmodem_byte[1][bytes[6]] ^ xmodem_byte[0][bytes[7]];
    }
    for (; length > 0; length--, bytes++) {
        crc = (crc << 8 & 0xFF00u) ^ xmodem_byte[0][crc >> 8 ^ *bytes];
    }
    return (uint16_t)crc;
}

size_t vn100_binary_frame(const vn100_binary_t *binary, const vn100_sense_t *sense,
                          uint8_t out[VN100_BINARY_MAX]) {
    const uint64_t stamp_ns = vn100_stamp_ns(sense, binary->divisor);
    uint8_t *at = out;
    *at++ = 0xFA;
    *at++ = (uint8_t)binary->groups;
    for (unsigned group = 0; group < VN100_GROUPS; group++) {
        if (binary->groups >> group & 1u) {
            at = put16(at, (uint16_t)binary->fields[group]);
        }
    }
    for (unsigned group = 0; group < VN100_GROUPS; group++) {
        uint32_t left = binary->groups >> group & 1u ? binary->fields[group] : 0;
        for (; left != 0; left &= left - 1u) {
            at = put_field(at, group, (unsigned)__builtin_ctz(left), sense, stamp_ns);
        }
    }
    const uint16_t crc = crc_xmodem(out + 1, (size_t)(at - out) - 1);
    *at++ = (uint8_t)(crc >> 8);
    *at++ = (uint8_t)crc;
    return (size_t)(at - out);
}

uint16_t vn100_check_of(vn100_check_t check, const void *bytes, size_t length) {
    const uint8_t *at = bytes;
    if (check == VN100_CHECK16) {
        return crc_xmodem(at, length);
    }
    uint8_t sum = 0;
    for (size_t i = 0; i < length; i++) {
        sum ^= at[i];
    }
    return sum;
}

size_t vn100_sealed(vn100_check_t check, const vn100_text_t *body, uint8_t out[VN100_MESSAGE_MAX]) {
    const unsigned sum = vn100_check_of(check, body->chars, body->length);
    const int length = snprintf((char *)out, VN100_MESSAGE_MAX, "$%s*%0*X\r\n", body->chars,
                                check == VN100_CHECK16 ? 4 : 2, sum);
    return (size_t)length < VN100_MESSAGE_MAX ? (size_t)length : VN100_MESSAGE_MAX - 1;
}
