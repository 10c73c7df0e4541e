/* COMMAND_ACK: what a command is answered. */
#ifndef LINK_COMMAND_ANSWER_H
#define LINK_COMMAND_ANSWER_H

#include "link/received.h"
#include "supervisor/faults.h"

typedef struct {
    uint8_t result; /* MAV_RESULT */
    fault_t fault;
} command_answer_t;

extern const command_answer_t command_accepted, command_unsupported, command_bad_values;

/* DENIED = would be refused again; TEMPORARILY_REJECTED = not now. */
command_answer_t command_answer_of(fault_t fault);

void command_answer_send(const received_t *in, uint16_t command, command_answer_t answer);

/* And the reason as a text, unless the command is unknown: ground stations try out many when they
 * connect. */
void command_answer_explain(const received_t *in, uint16_t command, command_answer_t answer);

#endif
