/* What hosts may ask of the board: the link's handlers (link.h). Main loop only. */
#ifndef APP_COMMANDS_H
#define APP_COMMANDS_H

#include "app/owners.h"

/* |context| is the app_t. */
fault_t commands_run(void *context, const link_command_t *command);
fault_t commands_param_set(void *context, param_t param, float value);
/* Refused unless the tail is off, disarmed and no trial is open. */
fault_t commands_set_key(void *context, const uint8_t *key, uint64_t time);

#endif
