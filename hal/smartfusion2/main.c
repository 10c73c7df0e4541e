#include "app/app.h"
#include "board.h"

hal_t board;

static app_t app;

void tick_isr(void) {
    time_tick_isr(&board);
    servo_frame_isr(&board);
    app_tick_isr(&app);
    board.wake = true;
}

/* Without WFI: QEMU's time passes with the instructions, and it skips what the core sleeps through,
 * or takes it from the computer's clock, by which ticks come late. */
static void wait_for_interrupt(void) {
    while (!board.wake) {
    }
}

/* By it 'tailbeat board flash' tells a board whose firmware hangs from a new one. */
static void report_start(void) {
    static const char line[] = "tailbeat starts\r\n";
    (void)hal_serial_write(&board, HAL_PORT_CONSOLE, (const uint8_t *)line, sizeof line - 1u);
}

int main(void) {
    chip_init(&board);
    time_init(&board);
    nor_init(&board);
    serial_init(&board);
    servo_init(&board);
    report_start();
    app_init(&app, &board);
    time_start_ticks();
    for (;;) {
        board.wake = false;
        app_poll(&app);
        wait_for_interrupt();
    }
}
