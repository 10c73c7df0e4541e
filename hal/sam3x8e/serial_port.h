/*
 * One serial port: two rings between the main loop and a USART (or the UART, which has less).
 *
 * Receiving. The DMA walks through the ring for ever, one half after the other; the interrupt that
 * a full half raises hands it the next. So the DMA always has half a ring in reserve, and the
 * deadline of that interrupt is half a ring's time: 44 ms for 4096 B at 921600 baud. The UART's
 * bytes come by interrupt instead, because it has no time-out with which to wake the main loop.
 *
 * Positions count bytes since boot, modulo 2^32; the ring sizes are powers of two, so position
 * modulo size is the place in the ring.
 *
 * How far the DMA is: |counted|, the halves that the interrupt has seen, plus the distance from
 * there to the DMA's pointer, modulo the ring size. |counted| is read first. Whatever happens after
 * that, the pointer moves on, the interrupt counts, both, leaves the sum true, as long as less than
 * a ring arrives between the two reads. The other way round, a half counted in between would put
 * the sum ahead of the DMA by half a ring.
 *
 * Too slow a reader: the DMA does not stop for it, it overtakes. The reader checks before it copies
 * and once more after it has; if by then the DMA has gone further than a ring beyond the first byte
 * it copied, part of the copy may be new bytes, and all of it is thrown away. What is lost is
 * counted.
 *
 * Sending. The interrupt handler takes from |sent|, the writer adds at |queued|; each writes its
 * own. While |sending| is 0 the end-of-block interrupt is masked, so only the writer may start a
 * block; while it is not, only the handler may. The writer moves |queued| before it looks at
 * |sending|: if it finds a block under way, the handler that ends this block sees the new bytes.
 */
#ifndef SAM3X8E_SERIAL_PORT_H
#define SAM3X8E_SERIAL_PORT_H

#include "registers/usart.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct {
    volatile usart_registers_t *usart;
    bool is_uart; /* no DMA for receiving, no time-out, no fractional divider */
    uint32_t baud;

    uint8_t *rx;
    uint32_t rx_bytes;         /* size, a power of two */
    volatile uint32_t counted; /* received, as far as the interrupts know */
    uint32_t taken;            /* by the reader */

    uint8_t *tx;
    uint32_t tx_bytes;         /* size, a power of two */
    volatile uint32_t queued;  /* by the writer */
    volatile uint32_t sent;    /* whole blocks */
    volatile uint32_t sending; /* length of the block under way; 0 = none */

    uint32_t skipped;          /* bytes: the reader was too slow */
    volatile uint32_t overrun; /* bytes: nobody took them out of the receiver */
    volatile uint32_t framing; /* bytes with a bad stop bit */
} serial_port_t;

/* Starts the port at |baud|. Pointers, sizes and |is_uart| are set, everything else 0; the
 * peripheral has its clock (without it the DMA's registers take nothing); its interrupt comes after
 * this. The speed may be off by more than 2 %: the nearest is taken. */
void serial_port_init(serial_port_t *port, uint32_t mck_hz, uint32_t baud);

/* As hal_serial_set_baud. Waits for the bytes that are in the transmitter, at most two. */
bool serial_port_set_baud(serial_port_t *port, uint32_t mck_hz, uint32_t baud);

/* As hal_serial_read, hal_serial_write, hal_serial_write_space. Main loop only. */
size_t serial_port_read(serial_port_t *port, uint8_t *out, size_t max);
size_t serial_port_write(serial_port_t *port, const uint8_t *bytes, size_t length);
size_t serial_port_space(const serial_port_t *port);

/* The port's interrupt handler. 1 to 2 us. */
void serial_port_isr(serial_port_t *port);

#endif
