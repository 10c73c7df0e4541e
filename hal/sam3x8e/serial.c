/* The three ports: which hardware, how much room, who is woken. */
#include "board.h"
#include "pins.h"

#include "base/panic.h"

#define BAUD_AT_START 115200u
/* The ATmega16U2 between USB and the console makes 117 647 baud of 115 200 (16 MHz / 8 / 17). The
 * UART has 114 130 and 116 667 to offer, 3 % and 0.8 % off that. */
#define CONSOLE_BAUD 116667u

/* The IMU's ring holds the longest pause of the main loop, 100 ms, at 460800 baud (4608 B); the
 * others hold it at 115200 (1152 B) with room for a burst after a break of the radio. */
#define IMU_RX_BYTES 8192u
#define RADIO_RX_BYTES 2048u
#define CONSOLE_RX_BYTES 2048u
#define TX_BYTES 1024u

static uint8_t imu_rx[IMU_RX_BYTES];
static uint8_t radio_rx[RADIO_RX_BYTES];
static uint8_t console_rx[CONSOLE_RX_BYTES];
static uint8_t tx[HAL_PORT_COUNT][TX_BYTES];

typedef struct {
    volatile usart_registers_t *usart;
    uint32_t id;
    uint32_t priority;
    uint32_t baud;
    uint8_t *rx;
    uint32_t rx_bytes;
    pin_t rx_pin, tx_pin;
} wiring_t;

static const wiring_t wiring[HAL_PORT_COUNT] = {
    [HAL_PORT_RADIO] = {USART1, ID_USART1, PRIORITY_DMA, BAUD_AT_START, radio_rx, RADIO_RX_BYTES,
                        PIN_RADIO_RX, PIN_RADIO_TX},
    [HAL_PORT_CONSOLE] = {UART, ID_UART, PRIORITY_CONSOLE, CONSOLE_BAUD, console_rx,
                          CONSOLE_RX_BYTES, PIN_CONSOLE_RX, PIN_CONSOLE_TX},
    [HAL_PORT_IMU] = {USART0, ID_USART0, PRIORITY_DMA, BAUD_AT_START, imu_rx, IMU_RX_BYTES,
                      PIN_IMU_RX, PIN_IMU_TX},
};

/* The transmitter idles high before it gets its pin, whose pull-up kept it high: no stray start
 * bit. The pull-ups of the inputs stay on, so that a port with nothing at it is quiet. */
static void start(hal_t *hal, hal_port_t number) {
    const wiring_t *wires = &wiring[number];
    serial_port_t *port = &hal->ports[number];
    *port = (serial_port_t){
        .usart = wires->usart,
        .is_uart = number == HAL_PORT_CONSOLE,
        .rx = wires->rx,
        .rx_bytes = wires->rx_bytes,
        .tx = tx[number],
        .tx_bytes = TX_BYTES,
    };
    clock_enable(wires->id);
    serial_port_init(port, hal->clocks.mck_hz, wires->baud);
    pin_to_peripheral(wires->rx_pin);
    pin_to_peripheral(wires->tx_pin);
    interrupt_enable(wires->id, wires->priority);
}

void serial_init(hal_t *hal) {
    for (uint32_t number = 0; number < HAL_PORT_COUNT; number++) {
        start(hal, (hal_port_t)number);
    }
}

static void handle_isr(hal_port_t port) {
    serial_port_isr(&board.ports[port]);
    board.wake = true;
}

void radio_isr(void) { handle_isr(HAL_PORT_RADIO); }
void console_isr(void) { handle_isr(HAL_PORT_CONSOLE); }
void imu_isr(void) { handle_isr(HAL_PORT_IMU); }

size_t hal_serial_read(hal_t *hal, hal_port_t port, uint8_t *out, size_t max) {
    REQUIRE(port < HAL_PORT_COUNT);
    return serial_port_read(&hal->ports[port], out, max);
}

size_t hal_serial_write(hal_t *hal, hal_port_t port, const uint8_t *bytes, size_t length) {
    REQUIRE(port < HAL_PORT_COUNT);
    return serial_port_write(&hal->ports[port], bytes, length);
}

size_t hal_serial_write_space(const hal_t *hal, hal_port_t port) {
    REQUIRE(port < HAL_PORT_COUNT);
    return serial_port_space(&hal->ports[port]);
}

bool hal_serial_set_baud(hal_t *hal, hal_port_t port, uint32_t baud) {
    REQUIRE(port < HAL_PORT_COUNT);
    return serial_port_set_baud(&hal->ports[port], hal->clocks.mck_hz, baud);
}

hal_serial_errors_t hal_serial_errors(const hal_t *hal, hal_port_t port) {
    REQUIRE(port < HAL_PORT_COUNT);
    const serial_port_t *counts = &hal->ports[port];
    return (hal_serial_errors_t){
        .overruns = counts->skipped + counts->overrun,
        .framing = counts->framing,
    };
}
