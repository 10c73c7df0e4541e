/*
 * The command interpreter of a VN-100: what it reads and changes, which is all of the sensor but
 * its line. UM001, "Serial commands", "System error codes".
 */
#ifndef SIM_VN100_COMMANDS_H
#define SIM_VN100_COMMANDS_H

#include "vn100_sense.h"
#include "vn100_settings.h"

typedef struct {
    unsigned firmware; /* 0 = there is no sensor */
    unsigned wire;     /* port that our wires are on: 0, 1 */
    uint64_t seed;
    vn100_settings_t settings, saved;
    vn100_sense_t sense;
    bool paused; /* $VNASY,0 */
} vn100_unit_t;

/* What a command wants done once its reply is out. */
typedef enum { VN100_GO_ON, VN100_SWITCH_BAUD, VN100_REBOOT } vn100_then_t;

/* How long the command in |line| ('$' to before CR or LF, zero-terminated) keeps the sensor busy
 * before it replies. */
uint64_t vn100_command_us(const char *line);

/* Executes it at |now_us|. |reply|: what to send, not sealed; empty = nothing. */
vn100_then_t vn100_command(vn100_unit_t *unit, uint64_t now_us, char *line, vn100_text_t *reply);

/* $VNERR, or nothing when register 30 wants none. */
void vn100_complain(vn100_unit_t *unit, vn100_error_t error, vn100_text_t *reply);

#endif
