/* A message of a VN-100, as the reader (reader.h) found it. */
#ifndef IMU_MESSAGE_H
#define IMU_MESSAGE_H

#include <stdint.h>

typedef enum { IMU_BINARY, IMU_LINE } imu_kind_t;

/* Points into the reader: valid until the next call with that reader. */
typedef struct {
    imu_kind_t kind;
    uint16_t length; /* sync to CRC; '$' to LF */
    const uint8_t *bytes;
} imu_message_t;

#endif
