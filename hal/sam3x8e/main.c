#include "app/app.h"
#include "board.h"

hal_t board;

static app_t app;

/* The tick: once per servo frame. */
void servo_isr(void) {
    servo_tick_isr(&board);
    timebase_tick_isr(&board);
    app_tick_isr(&app);
    board.wake = true;
    battery_tick_isr(&board);
}

/* A handler that runs between the last look at board.wake and the WFI would leave its bytes lying
 * until the next interrupt; with interrupts off it waits, and ends the WFI at once. */
static void sleep_until_interrupt(void) {
    cpu_interrupts_off();
    if (!board.wake) {
        cpu_wait_for_interrupt();
    }
    cpu_interrupts_on();
}

static void init_board(void) {
    timebase_init(&board);
    chip_init(&board);
    storage_flash_init(&board);
    serial_init(&board);
    battery_init(&board);
}

/* The DMA sends it whatever becomes of the main loop. By it 'tailbeat board flash' tells a board
 * whose firmware hangs, which has data to lose, from a new one. */
static void report_start(void) {
    static const char line[] = "tailbeat starts\r\n";
    (void)hal_serial_write(&board, HAL_PORT_CONSOLE, (const uint8_t *)line, sizeof line - 1u);
}

int main(void) {
    init_board();
    report_start();
    app_init(&app, &board);
    servo_init(&board);
    for (;;) {
        board.wake = false;
        app_poll(&app);
        sleep_until_interrupt();
    }
}
