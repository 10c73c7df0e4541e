#include "link/outbox.h"

#include "base/units.h"
#include "hal/clock.h"

#define REFUSAL_PERIOD_US 1000000u

void outbox_init(outbox_t *outbox, hal_t *hal) {
    outbox->hal = hal;
    for (uint32_t i = 0; i < OUTBOX_PORTS; i++) {
        channel_init(&outbox->channel[i], hal, (hal_port_t)i, &outbox->signing);
    }
}

void outbox_note_heard(outbox_t *outbox, const channel_t *channel, uint64_t now_us) {
    outbox->heard_until_us[channel->port] = now_us + OUTBOX_HEARD_US;
}

bool outbox_heard(const outbox_t *outbox, const channel_t *channel) {
    return hal_time_us(outbox->hal) < outbox->heard_until_us[channel->port];
}

void outbox_send(outbox_t *outbox, const message_form_t *form, const void *fields) {
    for (uint32_t i = 0; i < OUTBOX_PORTS; i++) {
        if (outbox_heard(outbox, &outbox->channel[i])) {
            (void)channel_send(&outbox->channel[i], form, fields);
        }
    }
}

uint32_t outbox_boot_ms(const outbox_t *outbox) {
    return (uint32_t)units_thousandth(hal_time_us(outbox->hal));
}

void outbox_text_to(channel_t *channel, uint8_t severity, const char *text) {
    mavlink_statustext_t fields = {.severity = severity};
    for (uint32_t i = 0; i < OUTBOX_TEXT_CHARS && text[i] != '\0'; i++) {
        fields.text[i] = text[i];
    }
    CHANNEL_SEND(channel, STATUSTEXT, &fields);
}

void outbox_text(outbox_t *outbox, uint8_t severity, const char *text) {
    for (uint32_t i = 0; i < OUTBOX_PORTS; i++) {
        outbox_text_to(&outbox->channel[i], severity, text);
    }
}

void outbox_warn(channel_t *channel, fault_t fault) {
    outbox_text_to(channel, MAV_SEVERITY_WARNING, fault_info(fault)->meaning);
}

void outbox_warn_refused(outbox_t *outbox, channel_t *channel, fault_t fault) {
    const uint64_t now_us = hal_time_us(outbox->hal);
    if (now_us >= outbox->next_refusal_us) {
        outbox->next_refusal_us = now_us + REFUSAL_PERIOD_US;
        outbox_warn(channel, fault);
    }
}
