#include "serial_port.h"

#include "registers/cortex_m3.h"

#include <string.h>

/* The line is quiet after four characters without one; the main loop is woken. */
#define QUIET_BITS 40u
#define BITS_PER_BYTE 10u

/* Per bit. */
#define UART_SAMPLES 16u
#define USART_SAMPLES 8u

#define SLOWEST_BAUD 9600u
#define FASTEST_BAUD 921600u

#define RECEIVE_ERRORS (USART_CSR_OVRE | USART_CSR_FRAME)

/* Bus addresses are 32 bits here. */
static uint32_t address(const uint8_t *place) { return (uint32_t)(uintptr_t)place; }

/* Place in a ring of |size| bytes. */
static uint32_t wrapped(uint32_t position, uint32_t size) { return position & (size - 1u); }

/* Position of the DMA, whose pointer is |pointer|, when it was at |past| not a ring ago. */
static uint32_t dma_position(uint32_t past, uint32_t pointer, const uint8_t *ring, uint32_t size) {
    return past + wrapped(pointer - address(ring) - past, size);
}

static uint32_t received(const serial_port_t *port) {
    const uint32_t counted = port->counted;
    const uint32_t position =
        port->is_uart ? counted
                      : dma_position(counted, port->usart->PDC.RPR, port->rx, port->rx_bytes);
    cpu_barrier();
    return position;
}

/* A full ring counts as overtaken: the byte that comes next is in memory before the pointer moves.
 */
static bool overtaken(const serial_port_t *port, uint32_t position) {
    return position - port->taken >= port->rx_bytes;
}

/* Bytes that wait. When the port has overtaken the reader, half a ring is given up, so that it does
 * not do so again at once. */
static uint32_t waiting_after_skip(serial_port_t *port) {
    const uint32_t position = received(port);
    const uint32_t waiting = position - port->taken;
    if (!overtaken(port, position)) {
        return waiting;
    }
    const uint32_t kept = port->rx_bytes / 2u;
    port->skipped += waiting - kept;
    port->taken = position - kept;
    return kept;
}

size_t serial_port_read(serial_port_t *port, uint8_t *out, size_t max) {
    const uint32_t waiting = waiting_after_skip(port);
    const uint32_t length = waiting < max ? waiting : (uint32_t)max;
    const uint32_t at = wrapped(port->taken, port->rx_bytes);
    const uint32_t first = length < port->rx_bytes - at ? length : port->rx_bytes - at;
    memcpy(out, port->rx + at, first);
    memcpy(out + first, port->rx, length - first);
    if (overtaken(port, received(port))) {
        (void)waiting_after_skip(port);
        return 0;
    }
    port->taken += length;
    return length;
}

/* The DMA has gone on into the half that it had in reserve: the one it has filled is next. Both
 * full means that this interrupt came half a ring late; then it stands still and is started again.
 */
static void give_next_half_isr(serial_port_t *port) {
    volatile pdc_registers_t *pdc = &port->usart->PDC;
    const uint32_t half = port->rx_bytes / 2u;
    port->counted += half;
    if (pdc->RCR == 0) {
        port->counted += half;
        pdc->RPR = address(port->rx + wrapped(port->counted, port->rx_bytes));
        pdc->RCR = half;
    }
    pdc->RNPR = address(port->rx + wrapped(port->counted + half, port->rx_bytes));
    pdc->RNCR = half;
}

static void take_byte_isr(serial_port_t *port) {
    port->rx[wrapped(port->counted, port->rx_bytes)] = (uint8_t)port->usart->RHR;
    port->counted++;
}

/* From what is queued to the end of the ring; the rest is the block after. */
static void send_block(serial_port_t *port) {
    const uint32_t waiting = port->queued - port->sent;
    const uint32_t at = wrapped(port->sent, port->tx_bytes);
    const uint32_t length = waiting < port->tx_bytes - at ? waiting : port->tx_bytes - at;
    port->sending = length;
    if (length == 0) {
        port->usart->IDR = USART_CSR_ENDTX;
        return;
    }
    port->usart->PDC.TPR = address(port->tx + at);
    port->usart->PDC.TCR = length;
    port->usart->IER = USART_CSR_ENDTX;
}

/* Bytes still in the ring: queued, and not yet fetched by the DMA. */
static uint32_t unsent(const serial_port_t *port) {
    const uint32_t sent = port->sent;
    return port->queued - dma_position(sent, port->usart->PDC.TPR, port->tx, port->tx_bytes);
}

size_t serial_port_space(const serial_port_t *port) { return port->tx_bytes - unsent(port); }

size_t serial_port_write(serial_port_t *port, const uint8_t *bytes, size_t length) {
    if (length > serial_port_space(port)) {
        return 0;
    }
    const uint32_t at = wrapped(port->queued, port->tx_bytes);
    const uint32_t first = length < port->tx_bytes - at ? (uint32_t)length : port->tx_bytes - at;
    memcpy(port->tx + at, bytes, first);
    memcpy(port->tx, bytes + first, length - first);
    cpu_barrier();
    port->queued += (uint32_t)length;
    if (port->sending == 0) {
        send_block(port);
    }
    return length;
}

static void count_errors_isr(serial_port_t *port, uint32_t events) {
    port->overrun += (events & USART_CSR_OVRE) != 0 ? 1u : 0u;
    port->framing += (events & USART_CSR_FRAME) != 0 ? 1u : 0u;
    port->usart->CR = USART_CR_RSTSTA;
}

void serial_port_isr(serial_port_t *port) {
    const uint32_t events = port->usart->CSR & port->usart->IMR;
    if ((events & RECEIVE_ERRORS) != 0) {
        count_errors_isr(port, events);
    }
    if ((events & USART_CSR_RXRDY) != 0) {
        take_byte_isr(port);
    }
    if ((events & USART_CSR_ENDRX) != 0) {
        give_next_half_isr(port);
    }
    if ((events & USART_CSR_TIMEOUT) != 0) {
        /* Counts again from the next byte on. One that came just now may go unnoticed until the
         * next tick. */
        port->usart->CR = USART_CR_STTTO;
    }
    if ((events & USART_CSR_ENDTX) != 0) {
        port->sent += port->sending;
        send_block(port);
    }
}

/* Clock cycles per bit. A USART that samples 8 times per bit (OVER) takes any number from 8 on, the
 * UART multiples of 16 (datasheet, "Baud Rate Generator"). */
static uint32_t nearest_divider(const serial_port_t *port, uint32_t mck_hz, uint32_t baud) {
    const uint32_t step = port->is_uart ? UART_SAMPLES : 1u;
    const uint32_t least = port->is_uart ? UART_SAMPLES : USART_SAMPLES;
    const uint32_t divider = (mck_hz + step * baud / 2u) / (step * baud) * step;
    return divider < least ? least : divider;
}

/* Within 2 %. */
static bool close_enough(uint32_t mck_hz, uint32_t divider, uint32_t baud) {
    const uint64_t wanted = (uint64_t)baud * divider;
    const uint64_t off = wanted > mck_hz ? wanted - mck_hz : mck_hz - wanted;
    return off * 50u <= wanted;
}

static void set_divider(const serial_port_t *port, uint32_t divider) {
    port->usart->BRGR = port->is_uart ? FIELD(USART_BRGR_CD, divider / UART_SAMPLES)
                                      : FIELD(USART_BRGR_CD, divider / USART_SAMPLES) |
                                            FIELD(USART_BRGR_FP, divider % USART_SAMPLES);
}

/* At most the byte in the transmitter and the one behind it. A pass takes more than one cycle. */
static void wait_for_transmitter(const serial_port_t *port, uint32_t mck_hz) {
    uint32_t passes = 2u * BITS_PER_BYTE * (mck_hz / port->baud);
    while ((port->usart->CSR & USART_CSR_TXEMPTY) == 0 && passes > 0) {
        passes--;
    }
}

bool serial_port_set_baud(serial_port_t *port, uint32_t mck_hz, uint32_t baud) {
    if (baud < SLOWEST_BAUD || baud > FASTEST_BAUD) {
        return false;
    }
    const uint32_t divider = nearest_divider(port, mck_hz, baud);
    if (!close_enough(mck_hz, divider, baud)) {
        return false;
    }
    port->usart->PDC.PTCR = PDC_PTCR_TXTDIS;
    wait_for_transmitter(port, mck_hz);
    set_divider(port, divider);
    port->baud = baud;
    port->usart->PDC.PTCR = PDC_PTCR_TXTEN;
    return true;
}

static void start_dma(const serial_port_t *port) {
    volatile pdc_registers_t *pdc = &port->usart->PDC;
    const uint32_t half = port->rx_bytes / 2u;
    pdc->PTCR = PDC_PTCR_RXTDIS | PDC_PTCR_TXTDIS;
    pdc->TPR = address(port->tx);
    pdc->TCR = 0;
    pdc->TNCR = 0;
    pdc->PTCR = PDC_PTCR_TXTEN;
    if (port->is_uart) {
        return;
    }
    pdc->RPR = address(port->rx);
    pdc->RCR = half;
    pdc->RNPR = address(port->rx + half);
    pdc->RNCR = half;
    pdc->PTCR = PDC_PTCR_RXTEN;
}

void serial_port_init(serial_port_t *port, uint32_t mck_hz, uint32_t baud) {
    volatile usart_registers_t *usart = port->usart;
    usart->CR = USART_CR_RSTRX | USART_CR_RSTTX | USART_CR_RXDIS | USART_CR_TXDIS;
    usart->IDR = UINT32_MAX;
    if (port->is_uart) {
        usart->MR = USART_MR_PAR_NO;
    } else {
        usart->MR = USART_MR_CHRL_8_BIT | USART_MR_PAR_NO | USART_MR_OVER;
        usart->RTOR = QUIET_BITS;
    }
    port->baud = baud;
    set_divider(port, nearest_divider(port, mck_hz, baud));
    start_dma(port);
    usart->CR = USART_CR_RSTSTA | USART_CR_RXEN | USART_CR_TXEN;
    if (port->is_uart) {
        usart->IER = RECEIVE_ERRORS | USART_CSR_RXRDY;
    } else {
        usart->CR = USART_CR_STTTO;
        usart->IER = RECEIVE_ERRORS | USART_CSR_ENDRX | USART_CSR_TIMEOUT;
    }
}
