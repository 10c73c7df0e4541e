#include "link/trust.h"

static fault_t judge(outbox_t *outbox, const received_t *in) {
    if (in->verdict == SIGNING_UNSIGNED) {
        outbox->signing.counters.unsigned_++;
        return FAULT_NOT_SIGNED;
    }
    return in->verdict == SIGNING_TRUSTED ? FAULT_NONE : FAULT_NOT_FRESH;
}

fault_t trust_refusal(outbox_t *outbox, const received_t *in) {
    const fault_t fault = judge(outbox, in);
    if (fault != FAULT_NONE) {
        outbox_warn_refused(outbox, in->channel, fault);
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

static fault_t may_set_key(outbox_t *outbox, const received_t *in) {
    if (in->channel->port != HAL_PORT_CONSOLE) {
        return FAULT_NOT_WIRED;
    }
    const bool unreadable = outbox->signing.locked && !outbox->signing.keyed;
    return unreadable ? FAULT_NONE : judge(outbox, in);
}

/* A key is set on one board only: a message to everybody is ignored. */
void trust_on_setup_signing(outbox_t *outbox, const link_handlers_t *handlers,
                            const received_t *in) {
    mavlink_setup_signing_t setup;
    RECEIVED_COPY(in, &setup);
    if (!received_is_ours_alone(setup.target_system, setup.target_component)) {
        return;
    }
    const bool erases = is_zero(setup.secret_key);
    fault_t fault = may_set_key(outbox, in);
    if (fault == FAULT_NONE) {
        fault = handlers->set_key(handlers->context, erases ? NULL : setup.secret_key,
                                  setup.initial_timestamp);
    }
    if (fault != FAULT_NONE) {
        outbox_warn(in->channel, fault);
    } else {
        outbox_text_to(in->channel, MAV_SEVERITY_INFO, erases ? "key erased" : "key set");
    }
}
