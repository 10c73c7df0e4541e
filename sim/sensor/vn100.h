/*
 * A VN-100 with its serial line: supply and start-up, bytes in and out, damage on the wire. It
 * answers commands (vn100_commands.c) and streams what it feels (vn100_sense.h) as its registers
 * say (vn100_settings.h). It has two ports; the fish's wires are on one of them, and what it sends
 * by the other is not modelled but counted where the sensor's own rules count it.
 *
 * Times are simulated microseconds; calls come in order of time. Source: user manual UM001 of
 * firmware 2, ICD of firmware 3, recordings.
 */
#ifndef SIM_VN100_H
#define SIM_VN100_H

#include "common/sim_config.h"
#include "vn100_commands.h"
#include "vn100_sense.h"
#include "vn100_settings.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define VN100_INPUT_BYTES 256u
#define VN100_OUTPUT_BYTES 2048u
#define VN100_QUEUE 64u

/* A message in the output buffer. */
typedef struct {
    uint64_t begin_us; /* its first bit leaves */
    uint32_t baud;
    uint16_t length;
} vn100_queued_t;

typedef struct {
    vn100_unit_t unit;
    double byte_errors, lost_bytes; /* probabilities per byte */
    bool plugged, powered;
    bool awake; /* there, plugged, powered and not wedged */
    /* Outputs. */
    uint64_t next_tick;    /* of the next output on our port; UINT64_MAX = none */
    uint64_t next_tick_us; /* when that is */
    /* Line out: messages wait here until the one before has left. */
    vn100_queued_t queue[VN100_QUEUE];
    uint32_t queue_head, queue_tail;
    uint8_t output[VN100_OUTPUT_BYTES];
    uint64_t output_head, output_tail;
    uint64_t free_us; /* the line is free from then on */
    bool overflowed;  /* and it was not told yet */
    /* Line in. */
    uint32_t listen_baud; /* until |switch_us|; then the register's */
    uint64_t switch_us;
    char input[VN100_INPUT_BYTES];
    size_t input_length;
    bool in_line; /* since the last '$' nothing impossible has come */
    bool busy;    /* with |command| */
    uint64_t busy_until_us;
    char command[VN100_INPUT_BYTES];
    uint64_t bytes_in, bytes_out; /* number the damage */
} vn100_t;

bool vn100_baud_valid(double baud);

/* Unpowered. |felt| is looked at from now on. */
void vn100_init(vn100_t *vn100, const sim_config_t *config, const felt_t *felt);

void vn100_power_on(vn100_t *vn100, uint64_t now_us);
void vn100_power_off(vn100_t *vn100);
/* A sensor that is plugged in starts anew if there is power. */
void vn100_plug(vn100_t *vn100, uint64_t now_us, bool plugged);
/* Starts anew with its saved settings, as after a dip of the supply or by its watchdog. */
void vn100_reboot(vn100_t *vn100, uint64_t now_us);
/* Silent and deaf until its supply is switched off. */
void vn100_wedge(vn100_t *vn100);

/* When the next message begins to leave; UINT64_MAX = none. */
uint64_t vn100_due_us(const vn100_t *vn100);
/* Takes that message as it arrives, damage included; 0 = nothing of it is left. */
size_t vn100_read(vn100_t *vn100, uint8_t out[VN100_MESSAGE_MAX]);
/* Rate of that message; without one the rate the sensor sends at. */
uint32_t vn100_baud(const vn100_t *vn100);

/* Bytes to the sensor, the last bit of which arrives now. At a rate that is not its own they are
 * garbage. */
void vn100_write(vn100_t *vn100, uint64_t now_us, const uint8_t *bytes, size_t length,
                 uint32_t baud);

#endif
