/* What the sensor's line and its command interpreter know of each other. */
#ifndef SIM_VN100_INTERNAL_H
#define SIM_VN100_INTERNAL_H

#include "vn100.h"

/* What a command wants done once its reply is out. */
typedef enum { VN100_GO_ON, VN100_SWITCH_BAUD, VN100_REBOOT } vn100_then_t;

/* How long the command in |line| ('$' to before CR or LF, zero-terminated) keeps the sensor busy
 * before it replies. */
uint64_t vn100_command_us(const char *line);

/* Executes it at |now_us|. |reply|: what to send, not sealed; empty = nothing. */
vn100_then_t vn100_command(vn100_t *vn100, uint64_t now_us, char *line, vn100_text_t *reply);

/* $VNERR, or nothing when register 30 wants none. */
void vn100_complain(vn100_t *vn100, vn100_error_t error, vn100_text_t *reply);

/* The newest sample at |now_us|. */
const vn100_sample_t *vn100_now(vn100_t *vn100, uint64_t now_us);

#endif
