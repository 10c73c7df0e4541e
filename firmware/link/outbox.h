/*
 * What the board sends, and to whom: a channel on each of the two ports, the key that signs on
 * both, and where a host was heard. Every other part of the link sends through it.
 *
 * Texts and HEARTBEATs go out on both ports always, all other telemetry only on ports where a host
 * was heard in the last OUTBOX_HEARD_US. What does not fit into a line is dropped and counted.
 * Main loop only.
 */
#ifndef LINK_OUTBOX_H
#define LINK_OUTBOX_H

#include "link/channel.h"
#include "link/signing.h"
#include "supervisor/faults.h"

#define OUTBOX_PORTS 2u /* HAL_PORT_RADIO, HAL_PORT_CONSOLE */
#define OUTBOX_HEARD_US 10000000u
#define OUTBOX_TEXT_CHARS 49u

typedef struct {
    hal_t *hal;
    uint64_t heard_until_us[OUTBOX_PORTS]; /* telemetry goes there until then */
    uint64_t next_refusal_us;              /* no text of a refusal before */
    signing_t signing;                     /* the application sets key and mark */
    channel_t channel[OUTBOX_PORTS];
} outbox_t;

void outbox_init(outbox_t *outbox, hal_t *hal);

/* A host was heard on |channel| at |now_us|. */
void outbox_note_heard(outbox_t *outbox, const channel_t *channel, uint64_t now_us);
bool outbox_heard(const outbox_t *outbox, const channel_t *channel);

/* Sends |fields| on every port where a host is heard; as channel_send. */
void outbox_send(outbox_t *outbox, const message_form_t *form, const void *fields);
#define OUTBOX_SEND(outbox, NAME, fields)                                                          \
    do {                                                                                           \
        CHANNEL_FORM(NAME, fields);                                                                \
        outbox_send((outbox), &form_, (fields));                                                   \
    } while (0)

/* time_boot_ms of what is sent now. */
uint32_t outbox_boot_ms(const outbox_t *outbox);

/* Sent on both ports. |severity| is a MAV_SEVERITY; text beyond OUTBOX_TEXT_CHARS is cut. */
void outbox_text(outbox_t *outbox, uint8_t severity, const char *text);

/* The same on one port; and the meaning of |fault| as a warning. */
void outbox_text_to(channel_t *channel, uint8_t severity, const char *text);
void outbox_warn(channel_t *channel, fault_t fault);

/* As outbox_warn, once a second at most: answers an unauthenticated host. */
void outbox_warn_refused(outbox_t *outbox, channel_t *channel, fault_t fault);

#endif
