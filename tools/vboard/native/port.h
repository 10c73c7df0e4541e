/* UART and USART with their PDC: 8N1, asynchronous, nothing else; as vboard/periph/usart.py.
 *
 * Bytes are moved when somebody looks: at a register, at the wire, or at the time of the next
 * interrupt.
 */
#ifndef VBOARD_PORT_H
#define VBOARD_PORT_H

#include "line.h"
#include "pdc.h"

#define VB_PORT_NAME_BYTES 8

typedef struct {
    vb_soc_t *soc;
    char name[VB_PORT_NAME_BYTES];
    int index;
    int pid; /* and interrupt */
    bool usart;
    int slot;
    vb_line_t *line; /* NULL: no wire */
    vb_pdc_t rx, tx;
    bool ready; /* it was reset once */
    bool receiver, transmitter;
    uint32_t sticky; /* RXRDY, OVRE, FRAME, TIMEOUT */
    uint32_t mask;
    uint8_t holding; /* RHR */
    bool shifting;   /* a byte is on the wire */
    uint8_t shifter;
    int64_t shift_end;
    bool waits; /* a byte is in THR */
    uint8_t waiting;
    int64_t bit_ticks; /* 0: no baud rate */
    int64_t timeout_bits;
    bool counting;
    int64_t silent_since; /* VB_NEVER: not known */
    uint32_t mode, divider, protected;
} vb_port_t;

void vb_port_init(vb_port_t *port, vb_soc_t *soc, const char *name, int index, int pid, bool usart);

/* Solders a wire to it. */
void vb_port_connect(vb_port_t *port, vb_line_t *line);

/* All off; a byte being sent is lost. */
void vb_port_reset(vb_port_t *port);

/* Receives and sends what time allows up to now. These may fail, like all below. */
void vb_port_sync(vb_port_t *port);

/* Starts what can start, drives the interrupt, plans the next event. */
void vb_port_replan(vb_port_t *port);

/* The master clock or the divider changed. */
void vb_port_retime(vb_port_t *port);

/* When the last bit of the byte now being sent, or of all that is to be sent, leaves; VB_NEVER when
 * idle. */
int64_t vb_port_next_sent(vb_port_t *port);
int64_t vb_port_all_sent(vb_port_t *port);

/* The registers, in port_registers.c. VB_UNKNOWN: there is none to be accessed like that. */
vb_access_t vb_port_read(vb_port_t *port, uint32_t offset, uint32_t *value);
vb_access_t vb_port_write(vb_port_t *port, uint32_t offset, uint32_t value);

/* Between the two files. */

#define VB_RXRDY (1u << 0)
#define VB_TXRDY (1u << 1)
#define VB_ENDRX (1u << 3)
#define VB_ENDTX (1u << 4)
#define VB_OVRE (1u << 5)
#define VB_FRAME (1u << 6)
#define VB_PARE (1u << 7)
#define VB_TIMEOUT (1u << 8)
#define VB_TXEMPTY (1u << 9)
#define VB_TXBUFE (1u << 11)
#define VB_RXBUFF (1u << 12)

uint32_t vb_port_status(const vb_port_t *port);
void vb_port_accept(vb_port_t *port, uint8_t byte);

#endif
