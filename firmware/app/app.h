/*
 * The firmware: all owners together (owners.h), one main-loop pass, one tick.
 *
 * A board's main() is: app_init(&app, hal); for (;;) { app_poll(&app); sleep until an interrupt; }
 * with app_tick_isr(&app) called once per 20 ms servo frame.
 */
#ifndef APP_APP_H
#define APP_APP_H

#include "app/owners.h"

/* Mounts the store, loads what is there, leaves BOOT. */
void app_init(app_t *app, hal_t *hal);

/* One pass of the main loop: bytes in, answers out, slots, log. */
void app_poll(app_t *app);

/* Once per 20 ms frame, interrupt context. */
void app_tick_isr(app_t *app);

#endif
