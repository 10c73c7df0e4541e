/*
 * The host that armed the fish. Hosts are told apart by port and system: only this one starts, and
 * only its heartbeats keep the board armed and the tail swimming.
 */
#ifndef TRIAL_HOST_H
#define TRIAL_HOST_H

#include "hal/serial.h"

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    hal_port_t port;
    uint8_t system;
    uint64_t last_heartbeat_us;
} trial_host_t;

static inline bool host_is(const trial_host_t *host, hal_port_t port, uint8_t system) {
    return port == host->port && system == host->system;
}

#endif
