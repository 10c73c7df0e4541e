/* Files that hosts have uploaded become what they are meant to be. Main loop only. */
#ifndef APP_UPLOADS_H
#define APP_UPLOADS_H

#include "app/owners.h"

/* LINK_COMMAND_COMMIT, in IDLE: checked, stored, in force. FAULT_NONE, and the file is gone; else
 * why not, and it stays. */
fault_t uploads_commit(app_t *app, const link_command_t *command);

#endif
