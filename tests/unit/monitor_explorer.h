/*
 * Visits every state of the monitor, from zeroed memory on, with every request, and judges each
 * answer by the history alone: which pulses went out before, and what the start announced.
 *
 * The ranges are small. That is enough: the monitor compares pulses and trial numbers only with
 * each other and with the limits, counts pulses down to zero, and compares a gap with one bound.
 */
#ifndef MONITOR_EXPLORER_H
#define MONITOR_EXPLORER_H

#include "monitor/monitor.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXPLORED_STATES_MAX 65536u
#define EXPLORED_PULSES 10u           /* 0..9 */
#define EXPLORED_TRIALS 3u            /* 1..3 */
#define EXPLORED_TICKS 3u             /* 0..2, of a swim and of a coast */
#define EXPLORED_CLOCK_US 0xFFFFA000u /* it wraps within the gap */

/* What has happened, as somebody knows who watches the pin and hears the requests. */
typedef struct {
    bool on; /* a pulse went out in the last tick */
    bool coasted;
    uint16_t pulse_ticks;
    uint32_t swum_ticks, swim_ticks, coasted_ticks, coast_ticks;
    uint32_t trial; /* highest number of a start that was right */
    monitor_limits_t limits;
} explored_history_t;

typedef struct {
    monitor_t monitor;
    explored_history_t history;
} explored_state_t;

typedef struct {
    uint32_t states, transitions, starts, pulses;
    uint32_t wrong_pulses; /* went out against a rule */
    uint32_t held_back;    /* did not go out though all rules allow it */
} explored_t;

static const uint32_t explored_gaps_us[] = {20000u, MONITOR_LATE_US, MONITOR_LATE_US + 1u};

static const monitor_limits_t explored_limits[] = {
    {.min_ticks = 3, .max_ticks = 7, .step_ticks = 2},
    {.min_ticks = 2, .max_ticks = 4, .step_ticks = UINT16_MAX},
    {0}, /* none */
};
#define EXPLORED_LIMITS (sizeof explored_limits / sizeof explored_limits[0])

static explored_state_t explored_states[EXPLORED_STATES_MAX];
static uint32_t explored_slots[4u * EXPLORED_STATES_MAX]; /* index + 1 */

static uint32_t explored_hash(const explored_state_t *state) {
    const uint8_t *bytes = (const uint8_t *)state;
    uint32_t hash = 2166136261u;
    for (size_t i = 0; i < sizeof *state; i++) {
        hash = (hash ^ bytes[i]) * 16777619u;
    }
    return hash;
}

/* Adds |state| unless it is known. */
static void explored_add(explored_t *explored, const explored_state_t *state) {
    const uint32_t slots = sizeof explored_slots / sizeof explored_slots[0];
    uint32_t slot = explored_hash(state) % slots;
    while (explored_slots[slot] != 0) {
        if (memcmp(&explored_states[explored_slots[slot] - 1u], state, sizeof *state) == 0) {
            return;
        }
        slot = (slot + 1u) % slots;
    }
    if (explored->states == EXPLORED_STATES_MAX) {
        abort();
    }
    explored_states[explored->states++] = *state;
    explored_slots[slot] = explored->states;
}

/* A start: a number not used yet, something to swim; the limits let a pulse through or not. */
static bool explored_starts(const explored_history_t *history, const monitor_request_t *request) {
    return request->swim && request->trial > history->trial && request->swim_ticks > 0;
}

static bool explored_in_limits(const monitor_limits_t *limits, uint16_t pulse_ticks) {
    return limits->min_ticks <= pulse_ticks && pulse_ticks <= limits->max_ticks;
}

static bool explored_goes_on(const explored_history_t *history, const monitor_request_t *request,
                             uint32_t gap_us) {
    const int step = (int)request->pulse_ticks - (int)history->pulse_ticks;
    const bool near = step <= history->limits.step_ticks && -step <= history->limits.step_ticks;
    const bool in_time = request->swim ? !history->coasted && gap_us <= 30000u &&
                                             history->swum_ticks < history->swim_ticks
                                       : history->coasted_ticks < history->coast_ticks;
    return near && in_time && explored_in_limits(&history->limits, request->pulse_ticks);
}

static bool explored_legal(const explored_history_t *history, const monitor_request_t *request,
                           uint32_t gap_us) {
    if (request->pulse_ticks == 0) {
        return false;
    }
    if (history->on) {
        return explored_goes_on(history, request, gap_us);
    }
    return explored_starts(history, request) &&
           explored_in_limits(&request->limits, request->pulse_ticks);
}

static void explored_remember(explored_history_t *history, const monitor_request_t *request,
                              uint16_t answer) {
    const bool asked = request->pulse_ticks != 0 && request->swim;
    if (!history->on && asked && request->trial > history->trial) {
        const uint32_t trial =
            request->trial; /* used up, whether its first pulse was right or not */
        *history = (explored_history_t){0};
        history->trial = trial;
        history->limits = request->limits;
        history->swim_ticks = request->swim_ticks;
        history->coast_ticks = request->coast_ticks;
    }
    history->on = answer != 0;
    history->pulse_ticks = answer;
    if (answer == 0) {
        const uint32_t trial = history->trial;
        memset(history, 0, sizeof *history);
        history->trial = trial;
        return;
    }
    history->coasted = !request->swim;
    history->swum_ticks += request->swim;
    history->coasted_ticks += !request->swim;
}

static void explored_step(explored_t *explored, const explored_state_t *from,
                          const monitor_request_t *request, uint32_t gap_us) {
    explored_state_t state = *from;
    const bool rests = monitor_rests(&state.monitor, request->pulse_ticks);
    const uint16_t answer = monitor_tick_isr(&state.monitor, request);
    const bool legal = explored_legal(&from->history, request, gap_us);
    explored->transitions++;
    explored->pulses += answer != 0;
    explored->starts += answer != 0 && !from->history.on;
    explored->wrong_pulses += answer != 0 && (!legal || answer != request->pulse_ticks);
    explored->wrong_pulses += rests && (answer != 0 || state.monitor.state != MONITOR_OFF);
    explored->held_back += answer == 0 && legal;
    explored_remember(&state.history, request, answer);
    state.monitor.tick_us = EXPLORED_CLOCK_US;
    explored_add(explored, &state);
}

static void explored_request(explored_t *explored, const explored_state_t *from,
                             monitor_request_t *request, uint32_t gap_us) {
    request->now_us = EXPLORED_CLOCK_US + gap_us;
    for (uint32_t start = 0; start < EXPLORED_TICKS * EXPLORED_TICKS * EXPLORED_TRIALS; start++) {
        request->swim_ticks = start % EXPLORED_TICKS;
        request->coast_ticks = (uint16_t)(start / EXPLORED_TICKS % EXPLORED_TICKS);
        request->trial = 1u + start / (EXPLORED_TICKS * EXPLORED_TICKS);
        for (uint32_t i = 0; i < EXPLORED_LIMITS; i++) {
            request->limits = explored_limits[i];
            explored_step(explored, from, request, gap_us);
        }
    }
}

static void explored_from(explored_t *explored, const explored_state_t *from) {
    for (uint32_t gap = 0; gap < 3u; gap++) {
        for (uint32_t pulse = 0; pulse < 2u * EXPLORED_PULSES; pulse++) {
            monitor_request_t request = {.pulse_ticks = (uint16_t)(pulse / 2u),
                                         .swim = pulse % 2u != 0};
            explored_request(explored, from, &request, explored_gaps_us[gap]);
        }
    }
}

static inline explored_t explore_monitor(void) {
    explored_t explored = {0};
    explored_state_t first;
    memset(explored_slots, 0, sizeof explored_slots);
    memset(&first, 0, sizeof first);
    first.monitor.tick_us = EXPLORED_CLOCK_US;
    explored_add(&explored, &first);
    /* A monitor that breaks a rule may have no end of states. */
    for (uint32_t i = 0; i < explored.states && !explored.wrong_pulses && !explored.held_back;
         i++) {
        const explored_state_t from = explored_states[i];
        explored_from(&explored, &from);
    }
    printf("monitor: %u states, %u transitions, %u starts, %u pulses; "
           "%u pulses against a rule, %u held back\n",
           (unsigned)explored.states, (unsigned)explored.transitions, (unsigned)explored.starts,
           (unsigned)explored.pulses, (unsigned)explored.wrong_pulses,
           (unsigned)explored.held_back);
    return explored;
}

#endif
