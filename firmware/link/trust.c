#include "link/link_internal.h"

#include "hal/clock.h"

#define REFUSAL_PERIOD_US 1000000u

static fault_t judge(link_t *link, const link_received_t *in) {
    if (in->verdict == SIGNING_UNSIGNED) {
        link->signing.counters.unsigned_++;
        return FAULT_NOT_SIGNED;
    }
    return in->verdict == SIGNING_TRUSTED ? FAULT_NONE : FAULT_NOT_FRESH;
}

static void tell(const link_received_t *in, fault_t fault) {
    link_send_text(in->channel, MAV_SEVERITY_WARNING, fault_info(fault)->meaning);
}

fault_t link_refusal(link_t *link, const link_received_t *in) {
    const fault_t fault = judge(link, in);
    const uint64_t now_us = hal_time_us(link->hal);
    if (fault != FAULT_NONE && now_us >= link->next_refusal_us) {
        link->next_refusal_us = now_us + REFUSAL_PERIOD_US;
        tell(in, fault);
    }
    return fault;
}

static bool is_zero(const uint8_t key[SIGNING_KEY_BYTES]) {
    uint32_t any = 0;
    for (uint32_t i = 0; i < SIGNING_KEY_BYTES; i++) {
        any |= key[i];
    }
    return any == 0;
}

static fault_t may_set_key(link_t *link, const link_received_t *in) {
    if (in->channel->port != HAL_PORT_CONSOLE) {
        return FAULT_NOT_WIRED;
    }
    const bool unreadable = link->signing.locked && !link->signing.keyed;
    return unreadable ? FAULT_NONE : judge(link, in);
}

/* Keys are not for everybody on the line: one addressed to nobody is not for us. */
void link_on_setup_signing(link_t *link, const link_received_t *in) {
    mavlink_setup_signing_t setup;
    mavlink_msg_setup_signing_decode(in->message, &setup);
    if (setup.target_system != LINK_SYSTEM ||
        !link_addressed(setup.target_system, setup.target_component)) {
        return;
    }
    const bool erases = is_zero(setup.secret_key);
    fault_t fault = may_set_key(link, in);
    if (fault == FAULT_NONE) {
        fault = link->handlers.set_key(link->handlers.context, erases ? NULL : setup.secret_key,
                                       setup.initial_timestamp);
    }
    if (fault != FAULT_NONE) {
        tell(in, fault);
    } else {
        link_send_text(in->channel, MAV_SEVERITY_INFO, erases ? "key erased" : "key set");
    }
}
