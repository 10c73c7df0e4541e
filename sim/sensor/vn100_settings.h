/*
 * The registers of a VN-100 that can be set, as numbers; one copy is in use, one in its flash.
 * Registers, defaults and formats: user manual UM001; firmware 3.x as its ICD tells.
 */
#ifndef SIM_VN100_SETTINGS_H
#define SIM_VN100_SETTINGS_H

#include "vn100_messages.h"
#include "vn100_text.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define VN100_PORTS 2u
#define VN100_BINARY_OUTPUTS 3u
#define VN100_VALUES 160u
#define VN100_BASE_HZ 800u

/* $VNERR */
typedef enum {
    VN100_OK = 0,
    VN100_BUFFER_OVERFLOW = 2,
    VN100_BAD_CHECKSUM = 3,
    VN100_BAD_COMMAND = 4,
    VN100_TOO_FEW = 5,
    VN100_TOO_MANY = 6,
    VN100_BAD_PARAMETER = 7,
    VN100_BAD_REGISTER = 8,
    VN100_UNAUTHORISED = 9,
    VN100_OUTPUT_OVERFLOW = 11,
    VN100_BAUD_TOO_LOW = 12
} vn100_error_t;

typedef struct {
    uint32_t baud, type, rate_hz; /* registers 5, 6, 7 */
} vn100_port_t;

typedef struct {
    unsigned firmware; /* 2, 3 */
    vn100_port_t port[VN100_PORTS];
    vn100_binary_t binary[VN100_BINARY_OUTPUTS];
    double value[VN100_VALUES]; /* of all other registers */
} vn100_settings_t;

/* Places of values that every sample needs: gravity's z in register 21, the windows of 85. */
#define VN100_GRAVITY 5u
#define VN100_WINDOW 6u

void vn100_settings_restore(vn100_settings_t *settings, unsigned firmware);

/* Values of a register without special treatment; NULL when there is none of that number. */
const double *vn100_setting(const vn100_settings_t *settings, unsigned id);

/* 8 or 16 bits, as register 30 asks. */
typedef enum { VN100_CHECK8 = 1, VN100_CHECK16 = 3 } vn100_check_t;
vn100_check_t vn100_check(const vn100_settings_t *settings);

/* Which port a command came by, and the fields after the register's number. */
typedef struct {
    unsigned port; /* 0, 1 */
    unsigned count;
    const char *const *field;
} vn100_arguments_t;

/* Appends ",value,value..." */
vn100_error_t vn100_setting_read(const vn100_settings_t *settings, unsigned id,
                                 const vn100_arguments_t *arguments, vn100_text_t *out);
/* Nothing changes unless it answers VN100_OK. */
vn100_error_t vn100_setting_write(vn100_settings_t *settings, unsigned id,
                                  const vn100_arguments_t *arguments);

/* Whether the outputs of |port| fit its line. */
bool vn100_settings_fit(const vn100_settings_t *settings, unsigned port);

bool vn100_baud_known(uint32_t baud);

#endif
