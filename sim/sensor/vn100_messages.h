/* Which messages a VN-100 can send, what they consist of, and how long they are. UM001,
 * "Asynchronous output messages", "Binary output messages". */
#ifndef SIM_VN100_MESSAGES_H
#define SIM_VN100_MESSAGES_H

#include <stddef.h>
#include <stdint.h>

#define VN100_GROUPS 8u
#define VN100_BINARY_MAX 600u

/* Parts of an ASCII message: Yaw-pitch-roll, Quaternion, Magnetic, Acceleration, Linear
 * acceleration, Inertial linear acceleration, Gyro, Temperature, Pressure, Delta. */
typedef struct {
    uint8_t type, register_id;
    const char *name, *parts;
} vn100_message_t;

/* Registers 75...77. */
typedef struct {
    uint32_t mode;    /* bit 0 = port 1, bit 1 = port 2 */
    uint32_t divisor; /* of 800 Hz */
    uint32_t groups;
    uint32_t fields[VN100_GROUPS]; /* by group */
} vn100_binary_t;

/* Of the type that register 6 names; NULL when there is none. */
const vn100_message_t *vn100_message(uint32_t type);
/* The one whose measurement register |id| holds; NULL when it holds none. */
const vn100_message_t *vn100_message_of_register(unsigned id);
/* Length with an 8-bit check and without what register 30 adds. */
size_t vn100_message_bytes(const vn100_message_t *message);

/* Length of one field of a group; 0 when the sensor has no such group or field. */
unsigned vn100_field_bytes(unsigned group, unsigned bit);
/* Length of the frame; 0 when the sensor has no such group or field. */
size_t vn100_binary_bytes(const vn100_binary_t *binary, unsigned firmware);

#endif
