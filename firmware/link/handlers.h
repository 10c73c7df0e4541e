/* What the application does with messages: its answers to commands, values, keys and samples. */
#ifndef LINK_HANDLERS_H
#define LINK_HANDLERS_H

#include "link/command.h"
#include "params/params.h"
#include "supervisor/faults.h"

typedef struct {
    uint64_t time_us; /* board time, middle of the sample's window */
    float speed_m_s;  /* along x, the swim direction */
    float sigma_m_s;  /* NaN = not given */
} link_vision_t;

/* The application's answers. |context| is handed back as it was given. */
typedef struct {
    void *context;
    /* FAULT_NONE = accepted, otherwise the reason for the refusal. */
    fault_t (*command)(void *context, const link_command_t *command);
    /* Sets it, or tells why not; |value| is finite, its range is not checked yet. */
    fault_t (*param_set)(void *context, param_t param, float value);
    /* |speed_m_s| as it came in, possibly not finite; |sigma_m_s| > 0 or NaN. */
    void (*vision)(void *context, const link_vision_t *sample);
    /* SETUP_SIGNING that came over the wired port, from somebody trusted or while the stored key
     * cannot be read; |key| NULL = no key any more. The answer is told as text: "key set", "key
     * erased", or the reason for the refusal. */
    fault_t (*set_key)(void *context, const uint8_t *key, uint64_t time);
    /* Of any system that is not a fish, when it is trusted. */
    void (*heartbeat)(void *context, hal_port_t port, uint8_t system, uint8_t component);
} link_handlers_t;

#endif
