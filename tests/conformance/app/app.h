/*
 * What a board starts: the conformance suite instead of the firmware. This folder comes before
 * firmware/ in the include path, so that the board's sources stay as they are.
 */
#ifndef APP_APP_H
#define APP_APP_H

#include "suite.h"

typedef suite_t app_t;

/* Says on the console who the board is and why it started. */
void app_init(app_t *app, hal_t *hal);

/* Takes commands; one step of the scenario that runs. */
void app_poll(app_t *app);

/* Once per 20 ms frame, interrupt context. */
void app_tick_isr(app_t *app);

#endif
