/*
 * The console: two rings between the main loop and MMUART0, whose interrupt moves the bytes. The
 * handler puts what came and takes what goes; the main loop does the other two. Positions count
 * bytes since boot, modulo 2^32; the ring sizes are powers of two.
 *
 * The radio and the IMU are not there: nothing comes, and what is sent is lost, as on a line with
 * nothing at its end.
 */
#include "board.h"

#include "base/panic.h"

#define BAUD_AT_START 115200u
#define TOLERANCE_PER_MILLE 20u

static uint32_t divisor_for(uint32_t baud) { return (APB0_HZ + 8u * baud) / (16u * baud); }

static void set_divisor(volatile uart_registers_t *uart, uint32_t divisor) {
    uart->LCR = UART_LCR_8_BITS | UART_LCR_DLAB;
    uart->RBR_THR_DLR = divisor & 0xFFu;
    uart->IER_DMR = divisor >> 8;
    uart->LCR = UART_LCR_8_BITS;
}

/* Fourteen of sixteen bytes, or a pause of four, raise the interrupt. */
void uart_start(volatile uart_registers_t *uart, uint32_t baud) {
    uart->IER_DMR = 0;
    set_divisor(uart, divisor_for(baud));
    uart->IIR_FCR = UART_FCR_ENABLE | UART_FCR_CLEAR_RX | UART_FCR_CLEAR_TX | UART_FCR_RX_14_BYTES;
    uart->MCR = 0;
}

void serial_init(hal_t *hal) {
    (void)hal;
    uart_start(MMUART0, BAUD_AT_START);
    MMUART0->IER_DMR = UART_IER_RECEIVED;
    interrupt_enable(INTERRUPT_MMUART0, PRIORITY_CONSOLE);
}

/* A full ring throws away what comes. */
static void receive_isr(hal_t *hal) {
    uint32_t status = MMUART0->LSR;
    while ((status & UART_LSR_READY) != 0) {
        const uint8_t byte = (uint8_t)MMUART0->RBR_THR_DLR;
        const bool full = hal->rx_put - hal->rx_got == RX_BYTES;
        hal->framing += (status & UART_LSR_FRAMING) != 0 ? 1u : 0u;
        hal->overruns += (full ? 1u : 0u) + ((status & UART_LSR_OVERRUN) != 0 ? 1u : 0u);
        if (!full) {
            hal->rx[hal->rx_put % RX_BYTES] = byte;
            hal->rx_put++;
        }
        status = MMUART0->LSR;
    }
}

/* Asks for an interrupt as long as there is something to send. */
static void send_isr(hal_t *hal) {
    if ((MMUART0->LSR & UART_LSR_THR_EMPTY) == 0) {
        return;
    }
    for (uint32_t i = 0; i < UART_FIFO_BYTES && hal->tx_got != hal->tx_put; i++) {
        MMUART0->RBR_THR_DLR = hal->tx[hal->tx_got % TX_BYTES];
        hal->tx_got++;
    }
    const bool more = hal->tx_got != hal->tx_put;
    MMUART0->IER_DMR = UART_IER_RECEIVED | (more ? UART_IER_SENT : 0u);
}

void console_isr(void) {
    (void)MMUART0->IIR_FCR;
    receive_isr(&board);
    send_isr(&board);
    board.wake = true;
}

size_t hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max) {
    REQUIRE(port < HAL_PORT_COUNT);
    size_t taken = 0;
    while (port == HAL_PORT_CONSOLE && taken < max && hal->rx_got != hal->rx_put) {
        out[taken++] = hal->rx[hal->rx_got % RX_BYTES];
        hal->rx_got++;
    }
    return taken;
}

size_t hal_serial_write_space(const hal_t *hal, hal_port_t port) {
    REQUIRE(port < HAL_PORT_COUNT);
    return port == HAL_PORT_CONSOLE ? TX_BYTES - (hal->tx_put - hal->tx_got) : TX_BYTES;
}

/* Letting the transmitter's interrupt through raises it, as nothing is being sent. */
size_t hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length) {
    if (length > hal_serial_write_space(hal, port)) {
        return 0;
    }
    for (size_t i = 0; port == HAL_PORT_CONSOLE && i < length; i++) {
        hal->tx[hal->tx_put % TX_BYTES] = bytes[i];
        hal->tx_put++;
    }
    if (port == HAL_PORT_CONSOLE && length > 0) {
        MMUART0->IER_DMR = UART_IER_RECEIVED | UART_IER_SENT;
    }
    return length;
}

bool hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud) {
    REQUIRE(port < HAL_PORT_COUNT);
    (void)hal;
    const uint32_t divisor = baud == 0 ? 0 : divisor_for(baud);
    if (divisor == 0 || divisor > 0xFFFFu) {
        return false;
    }
    const uint32_t real = APB0_HZ / (16u * divisor);
    const uint32_t off = real > baud ? real - baud : baud - real;
    if (off > baud / 1000u * TOLERANCE_PER_MILLE) {
        return false;
    }
    if (port == HAL_PORT_CONSOLE) {
        set_divisor(MMUART0, divisor);
    }
    return true;
}

hal_serial_errors_t hal_serial_errors(const hal_t *hal, hal_port_t port) {
    REQUIRE(port < HAL_PORT_COUNT);
    const bool there = port == HAL_PORT_CONSOLE;
    return (hal_serial_errors_t){.overruns = there ? hal->overruns : 0,
                                 .framing = there ? hal->framing : 0};
}
