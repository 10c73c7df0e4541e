#include "app/app.h"
#include "board.h"

hal_t board;

static app_t app;

/* Called once per frame of 20 ms, by the interrupt that begins the frame. Nothing of the firmware
 * may interrupt it; the serial ports may. */
void board_tick_isr(void) {
    app_tick_isr(&app);
    board.wake = true;
}

/* Before this: the startup code has set the stack, copied .data, cleared .bss, and started the
 * watchdog and the clocks. The tick starts after app_init(). */
int main(void) {
    app_init(&app, &board);
    for (;;) {
        board.wake = false;
        app_poll(&app);
        /* Sleep until an interrupt, without missing one that comes between the look at
         * |board.wake| and the sleep. */
    }
}
