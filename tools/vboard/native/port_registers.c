#include "port.h"

#define RSTRX 0x4u
#define RSTTX 0x8u
#define RXEN 0x10u
#define RXDIS 0x20u
#define TXEN 0x40u
#define TXDIS 0x80u
#define RSTSTA 0x100u
#define STTTO 0x800u
#define RETTO 0x8000u

#define MODE_8N1 0x8C0u /* USART: CHRL 8 bit, PAR none, one stop bit, MCK */
#define MODE_OVER (1u << 19)
#define MODE_UART 0x800u /* UART: PAR none */

#define FLAGS                                                                                      \
    (VB_RXRDY | VB_TXRDY | VB_ENDRX | VB_ENDTX | VB_OVRE | VB_FRAME | VB_PARE | VB_TXEMPTY |       \
     VB_TXBUFE | VB_RXBUFF)
#define COMMANDS (RSTRX | RSTTX | RXEN | RXDIS | TXEN | TXDIS | RSTSTA)

#define PROTECTION_KEY 0x555341u
#define RXTEN 0x1u
#define RXTDIS 0x2u
#define TXTEN 0x100u
#define TXTDIS 0x200u

enum {
    CR = 0x00,
    MR = 0x04,
    IER = 0x08,
    IDR = 0x0C,
    IMR = 0x10,
    CSR = 0x14,
    RHR = 0x18,
    THR = 0x1C,
    BRGR = 0x20,
    RTOR = 0x24,
    WPMR = 0xE4,
    RPR = VB_PDC_FIRST,
    RCR = 0x104,
    TPR = 0x108,
    TCR = 0x10C,
    RNPR = 0x110,
    RNCR = 0x114,
    TNPR = 0x118,
    TNCR = 0x11C,
    PTCR = 0x120,
    PTSR = 0x124
};

static bool failed(const vb_port_t *port) { return port->soc->clock->failure != VB_OK; }

/* Reading. */

static vb_access_t read_pdc(vb_port_t *port, uint32_t offset, uint32_t *value) {
    if (offset == PTSR) {
        *value = (port->rx.enabled ? RXTEN : 0) | (port->tx.enabled ? TXTEN : 0);
        return VB_DONE;
    }
    if (offset > TNCR) {
        return VB_UNKNOWN;
    }
    vb_port_sync(port);
    const vb_pdc_t *pdc = (offset & 8) ? &port->tx : &port->rx;
    if (offset >= RNPR) {
        *value = (offset & 4) ? pdc->next_counter : pdc->next_pointer;
    } else {
        *value = (offset & 4) ? pdc->counter : pdc->pointer;
    }
    return VB_DONE;
}

vb_access_t vb_port_read(vb_port_t *port, uint32_t offset, uint32_t *value) {
    if (offset % 4) {
        return VB_UNKNOWN;
    }
    if (offset >= VB_PDC_FIRST) {
        return read_pdc(port, offset, value);
    }
    switch (offset) {
    case MR:
        *value = port->mode;
        return VB_DONE;
    case IMR:
        *value = port->mask;
        return VB_DONE;
    case CSR:
        vb_port_sync(port);
        *value = vb_port_status(port);
        return VB_DONE;
    case RHR:
        vb_port_sync(port);
        port->sticky &= ~VB_RXRDY;
        vb_port_replan(port);
        *value = port->holding;
        return VB_DONE;
    case BRGR:
        *value = port->divider;
        return VB_DONE;
    case RTOR:
        *value = (uint32_t)port->timeout_bits;
        return port->usart ? VB_DONE : VB_UNKNOWN;
    case WPMR:
        *value = port->protected;
        return port->usart ? VB_DONE : VB_UNKNOWN;
    default:
        return VB_UNKNOWN;
    }
}

/* Writing. */

static bool only_bits(vb_port_t *port, const char *reg, uint32_t value, uint32_t allowed) {
    return vb_only_bits(port->soc->clock, port->name, reg, value, allowed);
}

static bool mode_known(const vb_port_t *port) {
    return port->usart ? (port->mode & ~MODE_OVER) == MODE_8N1 : port->mode == MODE_UART;
}

static bool unlocked(vb_port_t *port, const char *reg) {
    if (port->protected) {
        vb_violation(port->soc->clock, "write to %s %s while write protected", port->name, reg);
        return false;
    }
    return true;
}

static bool idle(vb_port_t *port, const char *reg) {
    vb_port_sync(port);
    if (port->shifting) {
        vb_violation(port->soc->clock, "%s %s written while a byte is being sent", port->name, reg);
        return false;
    }
    return !failed(port);
}

/* STTTO: wait for a byte, flag down. RETTO: count from now. */
static void command_timeout(vb_port_t *port, uint32_t value) {
    if (value & STTTO) {
        port->sticky &= ~VB_TIMEOUT;
        port->counting = false;
        port->silent_since = VB_NEVER;
    }
    if (value & RETTO) {
        port->counting = true;
        port->silent_since = port->soc->clock->now;
    }
}

/* Silence counts from the switching on. */
static void enable_receiver(vb_port_t *port, bool on) {
    if (on && !port->receiver && port->counting) {
        port->silent_since = port->soc->clock->now;
    }
    port->receiver = on;
}

static void reset_halves(vb_port_t *port, uint32_t value) {
    if (value & RSTRX) {
        port->receiver = false;
        port->sticky &= ~VB_RXRDY;
    }
    if (value & RSTTX) {
        port->transmitter = port->shifting = port->waits = false;
    }
}

/* Commands; resets first, off wins over on. */
static void write_cr(vb_port_t *port, uint32_t value) {
    uint32_t allowed = COMMANDS | (port->usart ? STTTO | RETTO : 0);
    if (!only_bits(port, " CR", value, allowed)) {
        return;
    }
    vb_port_sync(port);
    reset_halves(port, value);
    if (value & (RXEN | TXEN) && !mode_known(port)) {
        vb_violation(port->soc->clock, "%s MR 0x%08x is not 8N1 from MCK", port->name,
                     (unsigned)port->mode);
        return;
    }
    if (value & (RXEN | RXDIS)) {
        enable_receiver(port, !(value & RXDIS));
    }
    if (value & (TXEN | TXDIS)) {
        port->transmitter = !(value & TXDIS);
    }
    if (value & RSTSTA) {
        port->sticky &= ~(VB_OVRE | VB_FRAME | VB_PARE);
    }
    command_timeout(port, value);
    vb_port_replan(port);
}

static void write_mr(vb_port_t *port, uint32_t value) {
    if (unlocked(port, "MR") && idle(port, "MR")) {
        port->mode = value;
        vb_port_retime(port);
    }
}

static void write_brgr(vb_port_t *port, uint32_t value) {
    if (unlocked(port, "BRGR") &&
        only_bits(port, " BRGR", value, port->usart ? 0x7FFFFu : 0xFFFFu) && idle(port, "BRGR")) {
        port->divider = value;
        vb_port_retime(port);
        vb_port_replan(port);
    }
}

/* Time-out in bit times, counting from now; 0 = none. */
static void write_rtor(vb_port_t *port, uint32_t value) {
    if (!unlocked(port, "RTOR") || !only_bits(port, " RTOR", value, 0x1FFFFu)) {
        return;
    }
    if (value > 0 && value <= VB_BITS_PER_BYTE) {
        vb_violation(port->soc->clock, "%s RTOR %u is shorter than one byte", port->name,
                     (unsigned)value);
        return;
    }
    vb_port_sync(port);
    port->timeout_bits = value;
    if (value == 0) {
        port->sticky &= ~VB_TIMEOUT;
    }
    port->counting = value > 0;
    port->silent_since = port->soc->clock->now;
    vb_port_replan(port);
}

static void write_wpmr(vb_port_t *port, uint32_t value) {
    if (value >> 8 != PROTECTION_KEY) {
        vb_violation(port->soc->clock, "%s WPMR written without its key", port->name);
        return;
    }
    port->protected = value & 1;
}

/* A byte to send; only with TXRDY. */
static void write_thr(vb_port_t *port, uint32_t value) {
    vb_port_sync(port);
    if (!port->transmitter) {
        vb_violation(port->soc->clock, "%s THR written with the transmitter off", port->name);
        return;
    }
    if (port->waits) {
        vb_violation(port->soc->clock, "%s THR written without TXRDY: a byte is lost", port->name);
        return;
    }
    vb_port_accept(port, (uint8_t)value);
    vb_port_replan(port);
}

static void write_ier(vb_port_t *port, uint32_t value) {
    if (only_bits(port, " IER", value, FLAGS | (port->usart ? VB_TIMEOUT : 0))) {
        port->mask |= value;
        vb_port_replan(port);
    }
}

/* Transfers on and off; off wins. */
static void write_ptcr(vb_port_t *port, uint32_t value) {
    if (value & (RXTEN | RXTDIS)) {
        port->rx.enabled = !(value & RXTDIS);
    }
    if (value & (TXTEN | TXTDIS)) {
        port->tx.enabled = !(value & TXTDIS);
    }
}

static vb_access_t write_pdc(vb_port_t *port, uint32_t offset, uint32_t value) {
    if (offset > PTCR) {
        return VB_UNKNOWN;
    }
    vb_port_sync(port);
    vb_pdc_t *pdc = (offset & 8) ? &port->tx : &port->rx;
    bool counts = true;
    if (offset == PTCR) {
        write_ptcr(port, value);
    } else if (offset >= RNPR) {
        counts = offset & 4;
        (counts ? vb_pdc_set_next_counter : vb_pdc_set_next_pointer)(pdc, value);
    } else {
        counts = offset & 4;
        (counts ? vb_pdc_set_counter : vb_pdc_set_pointer)(pdc, value);
    }
    if (counts && !failed(port)) {
        vb_port_replan(port);
    }
    return VB_DONE;
}

vb_access_t vb_port_write(vb_port_t *port, uint32_t offset, uint32_t value) {
    if (offset % 4) {
        return VB_UNKNOWN;
    }
    if (offset >= VB_PDC_FIRST) {
        return write_pdc(port, offset, value);
    }
    if (!port->usart && (offset == RTOR || offset == WPMR)) {
        return VB_UNKNOWN;
    }
    switch (offset) {
    case CR:
        write_cr(port, value);
        return VB_DONE;
    case MR:
        write_mr(port, value);
        return VB_DONE;
    case IER:
        write_ier(port, value);
        return VB_DONE;
    case IDR:
        port->mask &= ~value;
        vb_port_replan(port);
        return VB_DONE;
    case THR:
        write_thr(port, value);
        return VB_DONE;
    case BRGR:
        write_brgr(port, value);
        return VB_DONE;
    case RTOR:
        write_rtor(port, value);
        return VB_DONE;
    case WPMR:
        write_wpmr(port, value);
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}
