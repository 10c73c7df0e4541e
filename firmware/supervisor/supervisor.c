#include "supervisor/supervisor.h"

#include "base/panic.h"

/* Nothing leads back to BOOT, so its number marks what is refused: all that is not listed. */
#define REFUSED STATE_BOOT

/* The column of EVENT_STOP is for faults of kind ABORT. */
static const state_t NEXT[STATE_COUNT][EVENT_COUNT] = {
    [STATE_BOOT] = {[EVENT_BOOTED] = STATE_IDLE},
    [STATE_IDLE] = {[EVENT_ARM] = STATE_ARMED, [EVENT_LEARN] = STATE_LEARNING},
    [STATE_ARMED] =
        {[EVENT_DISARM] = STATE_IDLE, [EVENT_START] = STATE_RUNNING, [EVENT_STOP] = STATE_IDLE},
    [STATE_RUNNING] = {[EVENT_SWUM] = STATE_SETTLING, [EVENT_STOP] = STATE_ABORTED},
    [STATE_SETTLING] = {[EVENT_SETTLED] = STATE_IDLE},
    [STATE_LEARNING] = {[EVENT_LEARNED] = STATE_IDLE},
    [STATE_ABORTED] = {[EVENT_CLEAR] = STATE_IDLE},
    [STATE_FAULT] = {[EVENT_CLEAR] = STATE_IDLE},
};

/* In ARMED only these end anything: a fish in the hand may well be tilted. */
static bool disarms(fault_t fault) {
    return fault == FAULT_ABORT_COMMAND || fault == FAULT_LINK_LOST || fault == FAULT_WALL;
}

static state_t after_stop(state_t state, fault_t fault) {
    switch (fault_info(fault)->kind) {
    case FAULT_KIND_FAULT:
        return state == STATE_BOOT ? REFUSED : STATE_FAULT;
    case FAULT_KIND_ABORT:
        return state == STATE_ARMED && !disarms(fault) ? REFUSED : NEXT[state][EVENT_STOP];
    case FAULT_KIND_NONE:
    case FAULT_KIND_REFUSAL:
        break;
    }
    return REFUSED;
}

static bool stopped(state_t state) { return state == STATE_ABORTED || state == STATE_FAULT; }

void supervisor_init(supervisor_t *supervisor) {
    *supervisor = (supervisor_t){.state = STATE_BOOT, .reason = FAULT_NONE};
}

bool supervisor_event(supervisor_t *supervisor, event_t event, fault_t fault) {
    REQUIRE(supervisor->state < STATE_COUNT && event < EVENT_COUNT);
    const state_t next =
        event == EVENT_STOP ? after_stop(supervisor->state, fault) : NEXT[supervisor->state][event];
    if (next == REFUSED) {
        return false;
    }
    if (!stopped(next)) {
        supervisor->reason = FAULT_NONE;
    } else if (!stopped(supervisor->state)) {
        supervisor->reason = fault;
    }
    supervisor->state = next;
    return true;
}

bool supervisor_allows(const supervisor_t *supervisor, event_t event) {
    supervisor_t trial = *supervisor;
    return supervisor_event(&trial, event, FAULT_ABORT_COMMAND);
}

bool state_is_armed(state_t state) { return state == STATE_ARMED || state == STATE_RUNNING; }

bool state_is_at_rest(state_t state) { return state == STATE_IDLE || stopped(state); }

const char *state_name(state_t state) {
    static const char *const NAMES[STATE_COUNT] = {
        [STATE_BOOT] = "BOOT",       [STATE_IDLE] = "IDLE",         [STATE_ARMED] = "ARMED",
        [STATE_RUNNING] = "RUNNING", [STATE_SETTLING] = "SETTLING", [STATE_LEARNING] = "LEARNING",
        [STATE_ABORTED] = "ABORTED", [STATE_FAULT] = "FAULT",
    };
    REQUIRE(state < STATE_COUNT);
    return NAMES[state];
}
