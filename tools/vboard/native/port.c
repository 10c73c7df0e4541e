#include "port.h"

#include "check.h"
#include <math.h>
#include <string.h>

static void happen(void *owner) { vb_port_replan(owner); }

void vb_port_init(vb_port_t *port, vb_soc_t *soc, const char *name, int index, int pid,
                  bool usart) {
    VB_CHECK(strlen(name) < VB_PORT_NAME_BYTES);
    memset(port, 0, sizeof *port);
    port->soc = soc;
    strcpy(port->name, name);
    port->index = index;
    port->pid = pid;
    port->usart = usart;
    port->silent_since = VB_NEVER;
    port->rx.soc = port->tx.soc = soc;
    port->rx.port = port->tx.port = port->name;
    port->rx.name = "receive PDC";
    port->tx.name = "transmit PDC";
    port->slot = vb_clock_reserve(soc->clock, happen, port);
}

void vb_port_connect(vb_port_t *port, vb_line_t *line) { port->line = line; }

void vb_port_reset(vb_port_t *port) {
    if (port->ready) {
        vb_port_sync(port);
    }
    port->ready = true;
    if (port->line != NULL && port->shifting) {
        port->line->in_flight_at_reset++;
    }
    vb_pdc_reset(&port->rx);
    vb_pdc_reset(&port->tx);
    vb_clock_disarm(port->soc->clock, port->slot);
    port->receiver = port->transmitter = false;
    port->sticky = port->mask = 0;
    port->holding = 0;
    port->shifting = port->waits = port->counting = false;
    port->shift_end = port->bit_ticks = port->timeout_bits = 0;
    port->silent_since = VB_NEVER;
    port->mode = port->divider = port->protected = 0;
    port->soc->set_irq(port->soc, port->pid, false);
}

/* The time. */

static int64_t char_ticks(const vb_port_t *port) {
    if (port->bit_ticks == 0) {
        vb_violation(port->soc->clock, "%s used without a baud rate (BRGR)", port->name);
    }
    return port->bit_ticks * VB_BITS_PER_BYTE;
}

static int64_t bit_cycles(const vb_port_t *port) {
    int64_t whole = port->divider & 0xFFFF;
    if (!port->usart) {
        return 16 * (int64_t)port->divider;
    }
    int64_t over = port->mode & (1u << 19) ? 1 : 2;
    return whole ? over * (8 * whole + (port->divider >> 16)) : 0;
}

void vb_port_retime(vb_port_t *port) {
    vb_port_sync(port);
    port->bit_ticks = bit_cycles(port) * *port->soc->mck_ticks;
}

static int64_t timeout_ticks(const vb_port_t *port) { return port->timeout_bits * port->bit_ticks; }

static bool timeout_armed(const vb_port_t *port) {
    return port->counting && port->receiver && !(port->sticky & VB_TIMEOUT) &&
           timeout_ticks(port) > 0;
}

static int64_t deadline(const vb_port_t *port) { return port->silent_since + timeout_ticks(port); }

/* Receiving. */

static bool samples(const vb_port_t *port, int64_t baud) {
    if (port->bit_ticks == 0) {
        return false;
    }
    return fabs((double)VB_TICKS_PER_S / (double)(port->bit_ticks * baud) - 1) <= VB_BAUD_TOLERANCE;
}

static void store(vb_port_t *port, const uint8_t *data, int64_t length, uint8_t mask) {
    int64_t stored = port->sticky & VB_RXRDY ? 0 : vb_pdc_put(&port->rx, data, length, mask);
    int64_t rest = length - stored;
    if (rest == 0 || port->soc->clock->failure != VB_OK) {
        return;
    }
    int64_t lost = rest - (port->sticky & VB_RXRDY ? 0 : 1);
    if (lost) {
        port->sticky |= VB_OVRE;
        port->line->overrun += lost;
    }
    port->sticky |= VB_RXRDY;
    port->holding = data[length - 1] ^ mask;
}

static void receive(vb_port_t *port, const vb_piece_t *piece) {
    if (!port->receiver) {
        port->line->receiver_off += piece->length;
        return;
    }
    if (timeout_armed(port) && piece->first > deadline(port)) {
        port->sticky |= VB_TIMEOUT;
        port->counting = false;
    }
    if (!(port->sticky & VB_TIMEOUT)) {
        port->counting = true;
        port->silent_since = piece->last;
    }
    uint8_t mask = 0;
    if (piece->framing || !samples(port, piece->baud)) {
        port->sticky |= VB_FRAME;
        port->line->garbled_to_chip += piece->length;
        mask = piece->framing ? 0 : VB_GARBLED;
    }
    store(port, piece->data, piece->length, mask);
}

/* Sending. */

/* Bytes on the wire, in THR and in the PDC, in this order; the PDC gives |wanted| of them. */
static uint8_t next_byte(vb_port_t *port, int64_t place) {
    if (place == 0) {
        return port->shifter;
    }
    return place == 1 && port->waits ? port->waiting : vb_pdc_get(&port->tx);
}

static void send_until(vb_port_t *port, int64_t now) {
    if (!port->shifting || port->shift_end > now) {
        return;
    }
    int64_t ticks = char_ticks(port);
    if (ticks == 0) {
        return;
    }
    int64_t done = 1 + (now - port->shift_end) / ticks;
    int64_t held = port->waits ? 2 : 1;
    int64_t wanted = done + 2 > held ? done + 2 - held : 0;
    int64_t left = port->transmitter ? vb_pdc_remaining(&port->tx) : 0;
    int64_t total = held + (wanted < left ? wanted : left);
    int64_t gone = done < total ? done : total;
    uint8_t rest[2] = {0, 0};
    uint8_t *out = NULL;
    if (port->line != NULL) {
        out = vb_line_deliver(port->line, port->shift_end, ticks, gone);
    }
    for (int64_t i = 0; i < total && port->soc->clock->failure == VB_OK; i++) {
        uint8_t byte = next_byte(port, i);
        if (i >= gone) {
            rest[i - gone] = byte;
        } else if (out != NULL) {
            out[i] = byte;
        }
    }
    port->shift_end += gone * ticks;
    port->shifting = total - gone > 0;
    port->waits = total - gone > 1;
    port->shifter = rest[0];
    port->waiting = rest[1];
}

void vb_port_accept(vb_port_t *port, uint8_t byte) {
    if (!port->soc->txd_given(port->index)) {
        vb_violation(port->soc->clock, "%s sends, but its pin is not given to it (PIO_PDR)",
                     port->name);
        return;
    }
    if (port->shifting) {
        port->waits = true;
        port->waiting = byte;
        return;
    }
    port->shift_end = port->soc->clock->now + char_ticks(port);
    port->shifting = true;
    port->shifter = byte;
}

/* Moves into the port what waits at its door: held byte to the PDC, PDC to THR. */
static void feed(vb_port_t *port) {
    if (port->sticky & VB_RXRDY && vb_pdc_put(&port->rx, &port->holding, 1, 0)) {
        port->sticky &= ~VB_RXRDY;
    }
    /* At most two bytes: the port then holds what it can. */
    while (port->transmitter && !port->waits && vb_pdc_remaining(&port->tx) &&
           port->soc->clock->failure == VB_OK) {
        vb_port_accept(port, vb_pdc_get(&port->tx));
    }
}

/* What happens by itself. */

void vb_port_sync(vb_port_t *port) {
    int64_t now = port->soc->clock->now;
    vb_piece_t piece;
    while (port->line != NULL && port->soc->clock->failure == VB_OK &&
           vb_line_fetch(port->line, now, &piece)) {
        receive(port, &piece);
    }
    if (timeout_armed(port) && now >= deadline(port)) {
        port->sticky |= VB_TIMEOUT;
        port->counting = false;
    }
    send_until(port, now);
}

uint32_t vb_port_status(const vb_port_t *port) {
    uint32_t flags = port->sticky;
    flags |= port->rx.ended ? VB_ENDRX : 0;
    flags |= port->tx.ended ? VB_ENDTX : 0;
    flags |= vb_pdc_empty(&port->rx) ? VB_RXBUFF : 0;
    flags |= vb_pdc_empty(&port->tx) ? VB_TXBUFE : 0;
    if (port->transmitter) {
        flags |= port->waits ? 0 : VB_TXRDY;
        flags |= port->shifting ? 0 : VB_TXEMPTY;
    }
    return flags;
}

static int64_t earlier(int64_t one, int64_t other) { return one < other ? one : other; }

static int64_t receive_event(const vb_port_t *port) {
    const vb_line_t *line = port->line;
    if (line == NULL || !port->receiver) {
        return VB_NEVER;
    }
    uint32_t wanted = port->mask & ~vb_port_status(port);
    int64_t room = vb_pdc_remaining(&port->rx);
    int64_t due = VB_NEVER;
    if (wanted & VB_ENDRX && room) {
        due = earlier(due, vb_line_arrival(line, port->rx.counter - 1));
    }
    if (wanted & VB_RXBUFF && room) {
        due = earlier(due, vb_line_arrival(line, room - 1));
    }
    if (wanted & VB_RXRDY) {
        due = earlier(due, vb_line_arrival(line, room));
    }
    if (wanted & VB_OVRE) {
        due = earlier(due, vb_line_arrival(line, room + (port->sticky & VB_RXRDY ? 0 : 1)));
    }
    if (wanted & VB_FRAME && port->bit_ticks) {
        double baud = (double)VB_TICKS_PER_S / (double)port->bit_ticks;
        due = earlier(due, vb_line_bad_arrival(line, baud));
    }
    if (wanted & VB_TIMEOUT && timeout_ticks(port)) {
        int64_t since = port->counting ? port->silent_since : VB_NEVER;
        due = earlier(due, vb_line_silence(line, since, timeout_ticks(port)));
    }
    return due;
}

static int64_t send_event(const vb_port_t *port) {
    if (!port->shifting) {
        return VB_NEVER;
    }
    uint32_t wanted = port->mask & ~vb_port_status(port);
    int64_t ticks = char_ticks(port), end = port->shift_end;
    int64_t left = port->transmitter ? vb_pdc_remaining(&port->tx) : 0;
    int64_t due = VB_NEVER;
    if (wanted & VB_ENDTX && left) {
        due = earlier(due, end + ((int64_t)port->tx.counter - 1) * ticks);
    }
    if (wanted & VB_TXBUFE && left) {
        due = earlier(due, end + (left - 1) * ticks);
    }
    if (wanted & VB_TXRDY) {
        due = earlier(due, end + left * ticks);
    }
    if (wanted & VB_TXEMPTY) {
        due = earlier(due, end + (left + (port->waits ? 1 : 0)) * ticks);
    }
    return due;
}

void vb_port_replan(vb_port_t *port) {
    vb_port_sync(port);
    feed(port);
    if (port->soc->clock->failure != VB_OK) {
        return;
    }
    port->soc->set_irq(port->soc, port->pid, (vb_port_status(port) & port->mask) != 0);
    int64_t due = earlier(receive_event(port), send_event(port));
    if (due == vb_clock_due(port->soc->clock, port->slot)) {
        return;
    }
    if (due == VB_NEVER) {
        vb_clock_disarm(port->soc->clock, port->slot);
    } else {
        vb_clock_arm(port->soc->clock, port->slot, due);
    }
}

int64_t vb_port_next_sent(vb_port_t *port) {
    vb_port_sync(port);
    return port->shifting ? port->shift_end : VB_NEVER;
}

int64_t vb_port_all_sent(vb_port_t *port) {
    vb_port_sync(port);
    if (!port->shifting) {
        return VB_NEVER;
    }
    int64_t left = (port->waits ? 1 : 0) + vb_pdc_remaining(&port->tx);
    return port->shift_end + left * char_ticks(port);
}
