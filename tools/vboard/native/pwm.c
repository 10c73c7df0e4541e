#include "pwm.h"

#include "check.h"
#include <string.h>

#define CLKA 0xBu
#define CPOL (1u << 9)
#define PWM_IRQ 36

static void end_period(void *owner);

void vb_pwm_drive(vb_pwm_t *pwm) {
    pwm->soc->set_irq(pwm->soc, PWM_IRQ, (pwm->flags & pwm->mask) != 0);
}

void vb_pwm_tell(const vb_pwm_t *pwm) { pwm->soc->pwm_changed(); }

void vb_pwm_init(vb_pwm_t *pwm, vb_soc_t *soc) {
    memset(pwm, 0, sizeof *pwm);
    pwm->soc = soc;
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        pwm->channels[i].pwm = pwm;
        pwm->channels[i].number = i;
        pwm->channels[i].slot = vb_clock_reserve(soc->clock, end_period, &pwm->channels[i]);
    }
}

static void reset_channel(vb_channel_t *channel) {
    vb_clock_disarm(channel->pwm->soc->clock, channel->slot);
    channel->running = channel->stopping = false;
    channel->start = 0;
    channel->unit = 1;
    channel->duty_next = channel->period_next = VB_NEVER;
    channel->mode = channel->duty = channel->period = 0;
}

void vb_pwm_reset(vb_pwm_t *pwm) {
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        reset_channel(&pwm->channels[i]);
    }
    pwm->clk = pwm->flags = pwm->mask = pwm->scm = 0;
    pwm->output_values = pwm->override = 0;
    pwm->set_next = pwm->clear_next = 0;
    vb_pwm_drive(pwm);
    vb_pwm_tell(pwm);
}

/* Clock ticks per count; 0 after a failure. */
static int64_t unit_of(const vb_channel_t *channel) {
    const vb_pwm_t *pwm = channel->pwm;
    int64_t mck = *pwm->soc->mck_ticks;
    uint32_t prescaler = channel->mode & 0xF;
    if (prescaler <= 10) {
        return mck << prescaler;
    }
    uint32_t clk = pwm->clk >> (prescaler == CLKA ? 0 : 16);
    if ((clk & 0xFF) == 0) {
        vb_violation(pwm->soc->clock, "PWM channel %d runs on a clock that is off (CLK)",
                     channel->number);
        return 0;
    }
    return (mck << (clk >> 8 & 0xF)) * (clk & 0xFF);
}

void vb_pwm_retime(vb_pwm_t *pwm) {
    int64_t now = pwm->soc->clock->now;
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        vb_channel_t *channel = &pwm->channels[i];
        if (!channel->running) {
            continue;
        }
        int64_t count = (now - channel->start) / channel->unit;
        channel->unit = unit_of(channel);
        if (channel->unit == 0) {
            return;
        }
        channel->start = now - count * channel->unit;
        vb_clock_arm(pwm->soc->clock, channel->slot,
                     now + (channel->period - count) * channel->unit);
    }
    vb_pwm_tell(pwm);
}

/* Outputs. */

static uint32_t output_bit(int channel, bool high) { return 1u << (channel + (high ? 0 : 16)); }

static bool first_level(const vb_pwm_t *pwm, int channel, bool high) {
    return high == ((pwm->channels[channel].mode & CPOL) != 0);
}

bool vb_pwm_waveform(const vb_pwm_t *pwm, int channel, bool high, int64_t *turn) {
    const vb_channel_t *state = &pwm->channels[channel];
    uint32_t bit = output_bit(channel, high);
    *turn = VB_NEVER;
    if (pwm->override & bit) {
        return pwm->output_values & bit;
    }
    bool level = first_level(pwm, channel, high);
    if (!state->running) {
        return level;
    }
    int64_t end = state->start + state->duty * state->unit;
    if (pwm->soc->clock->now < end) {
        *turn = end;
        return level;
    }
    return !level;
}

int64_t vb_pwm_high_counts(const vb_pwm_t *pwm, int channel, bool high) {
    const vb_channel_t *state = &pwm->channels[channel];
    uint32_t bit = output_bit(channel, high);
    if (pwm->override & bit) {
        return pwm->output_values & bit ? state->period : 0;
    }
    return first_level(pwm, channel, high) ? state->duty : (int64_t)state->period - state->duty;
}

bool vb_pwm_running(const vb_pwm_t *pwm, int channel) { return pwm->channels[channel].running; }

/* A period's life. */

static bool check_duty(const vb_channel_t *channel) {
    if (channel->period != 0 && channel->duty <= channel->period) {
        return true;
    }
    vb_violation(channel->pwm->soc->clock, "PWM channel %d: duty %u of a period of %u",
                 channel->number, (unsigned)channel->duty, (unsigned)channel->period);
    return false;
}

static void begin_period(vb_channel_t *channel) {
    vb_pwm_t *pwm = channel->pwm;
    channel->start = pwm->soc->clock->now;
    int64_t period = channel->period;
    vb_clock_arm(pwm->soc->clock, channel->slot, channel->start + period * channel->unit);
    vb_pwm_tell(pwm);
    int64_t high = vb_pwm_high_counts(pwm, channel->number, false);
    pwm->soc->pwm_period(channel->number, channel->start, period, high);
}

static bool take_over(vb_channel_t *channel) {
    vb_pwm_t *pwm = channel->pwm;
    if (channel->period_next != VB_NEVER) {
        channel->period = (uint32_t)channel->period_next;
        channel->period_next = VB_NEVER;
    }
    if (channel->duty_next != VB_NEVER) {
        channel->duty = (uint32_t)channel->duty_next;
        channel->duty_next = VB_NEVER;
    }
    if (!check_duty(channel)) {
        return false;
    }
    uint32_t own = 0x00010001u << channel->number;
    pwm->override |= pwm->set_next & own;
    pwm->override &= ~(pwm->clear_next & own);
    pwm->set_next &= ~own;
    pwm->clear_next &= ~own;
    return true;
}

static void end_period(void *owner) {
    vb_channel_t *channel = owner;
    vb_pwm_t *pwm = channel->pwm;
    if (!take_over(channel)) {
        return;
    }
    pwm->flags |= 1u << channel->number;
    vb_pwm_drive(pwm);
    if (channel->stopping) {
        channel->running = channel->stopping = false;
        vb_pwm_tell(pwm);
    } else {
        begin_period(channel);
    }
}

bool vb_pwm_refuse_if_running(vb_pwm_t *pwm, const char *what) {
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        if (pwm->channels[i].running) {
            vb_violation(pwm->soc->clock, "%s while PWM channel %d runs", what, i);
            return false;
        }
    }
    return true;
}

bool vb_pwm_start(vb_channel_t *channel) {
    channel->stopping = false;
    if (channel->running) {
        return true;
    }
    if (!check_duty(channel)) {
        return false;
    }
    int64_t unit = unit_of(channel);
    if (unit == 0) {
        return false;
    }
    channel->unit = unit;
    channel->running = true;
    begin_period(channel);
    return true;
}
