/* What the hosts are told of the board. Main loop only. */
#ifndef APP_STATUS_H
#define APP_STATUS_H

#include "app/owners.h"

/* As it is at this moment, into app->loop.status. */
void status_refresh(app_t *app);

#endif
