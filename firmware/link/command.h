/* Commands the application decides on, as they came over the link. */
#ifndef LINK_COMMAND_H
#define LINK_COMMAND_H

#include "hal/serial.h"
#include "store/vault.h"

#include <stdbool.h>
#include <stdint.h>

#define LINK_BLINK_MAX_S 60.0f

typedef enum {
    LINK_COMMAND_ARM, /* blink_s */
    LINK_COMMAND_DISARM,
    LINK_COMMAND_START,   /* trial, issued_s */
    LINK_COMMAND_ABORT,   /* wall */
    LINK_COMMAND_LEARN,   /* trial */
    LINK_COMMAND_DISCARD, /* trial */
    LINK_COMMAND_RESTORE_BEST,
    LINK_COMMAND_CLEAR,
    LINK_COMMAND_COMMIT, /* file, length_bytes, crc */
    LINK_COMMAND_PARAMS_LOAD,
    LINK_COMMAND_PARAMS_SAVE,
    LINK_COMMAND_PARAMS_RESET,
    LINK_COMMAND_IMU_SAVE,
    LINK_COMMAND_IMU_ROW, /* row, element */
    LINK_COMMAND_REBOOT   /* take note and return; reset once the ACK has left (200 ms later) */
} link_command_id_t;

typedef struct {
    link_command_id_t id;
    uint32_t trial;
    float issued_s; /* board time; NaN = not given */
    float blink_s;  /* 0 to LINK_BLINK_MAX_S */
    bool wall;      /* the fish came too close to one */
    uint8_t row;    /* < IMU_ROWS */
    float element[3];
    vault_upload_t file;
    uint32_t length_bytes;
    uint32_t crc;
    hal_port_t port; /* where it came in */
    uint8_t system;  /* who sent it */
    uint8_t component;
} link_command_t;

#endif
