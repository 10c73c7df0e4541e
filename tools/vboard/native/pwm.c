#include "pwm.h"

#include "check.h"
#include <stdio.h>
#include <string.h>

#define OUTPUTS 0x00FF00FFu /* OOV and friends: PWMH in [7:0], PWML in [23:16] */
#define CLKA 0xBu
#define CLKB 0xCu
#define CPOL (1u << 9)
#define PWM_IRQ 36
#define CHANNELS_START 0x200u
#define CHANNEL_BYTES 0x20u
#define NAME_BYTES 24

enum {
    CLK = 0x00,
    ENA = 0x04,
    DIS = 0x08,
    SR = 0x0C,
    IER1 = 0x10,
    IDR1 = 0x14,
    IMR1 = 0x18,
    ISR1 = 0x1C,
    SCM = 0x20,
    OOV = 0x44,
    OS = 0x48,
    OSS = 0x4C,
    OSC = 0x50,
    OSSUPD = 0x54,
    OSCUPD = 0x58
};
enum { CMR = 0x00, CDTY = 0x04, CDTYUPD = 0x08, CPRD = 0x0C, CPRDUPD = 0x10, CCNT = 0x14 };

static void end_period(void *owner);

static void drive(vb_pwm_t *pwm) {
    pwm->soc->set_irq(pwm->soc, PWM_IRQ, (pwm->flags & pwm->mask) != 0);
}

static void tell(const vb_pwm_t *pwm) { pwm->soc->pwm_changed(); }

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
    drive(pwm);
    tell(pwm);
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
    tell(pwm);
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
    tell(pwm);
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
    drive(pwm);
    if (channel->stopping) {
        channel->running = channel->stopping = false;
        tell(pwm);
    } else {
        begin_period(channel);
    }
}

/* Registers of all channels. */

bool vb_pwm_refuse_if_running(vb_pwm_t *pwm, const char *what) {
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        if (pwm->channels[i].running) {
            vb_violation(pwm->soc->clock, "%s while PWM channel %d runs", what, i);
            return false;
        }
    }
    return true;
}

static bool only_bits(const vb_pwm_t *pwm, const char *name, uint32_t value, uint32_t allowed) {
    return vb_only_bits(pwm->soc->clock, name, "", value, allowed);
}

static void write_clk(vb_pwm_t *pwm, uint32_t value) {
    if (!only_bits(pwm, "PWM_CLK", value, 0x0FFF0FFFu)) {
        return;
    }
    if ((value >> 8 & 0xF) > 10 || (value >> 24 & 0xF) > 10) {
        vb_violation(pwm->soc->clock, "PWM_CLK 0x%08x: reserved prescaler", (unsigned)value);
        return;
    }
    if (vb_pwm_refuse_if_running(pwm, "PWM_CLK written")) {
        pwm->clk = value;
    }
}

static bool start(vb_channel_t *channel) {
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

static void write_ena(vb_pwm_t *pwm, uint32_t value) {
    if (!only_bits(pwm, "PWM_ENA", value, 0xFF)) {
        return;
    }
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        if (value >> i & 1 && !start(&pwm->channels[i])) {
            return;
        }
    }
}

/* Stops channels at the end of their period. */
static void write_dis(vb_pwm_t *pwm, uint32_t value) {
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        if (value >> i & 1 && pwm->channels[i].running) {
            pwm->channels[i].stopping = true;
        }
    }
}

static uint32_t running_channels(const vb_pwm_t *pwm) {
    uint32_t value = 0;
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        value |= pwm->channels[i].running ? 1u << i : 0;
    }
    return value;
}

static void write_override(vb_pwm_t *pwm, uint32_t value) {
    if (only_bits(pwm, "PWM_OS", value, OUTPUTS)) {
        pwm->override = value;
        tell(pwm);
    }
}

/* One channel. */

/* False, with a failure, unless the channel runs or not as |running| wants it. */
static bool state_is(const vb_channel_t *channel, bool running, const char *reg) {
    if (channel->running == running) {
        return true;
    }
    vb_violation(channel->pwm->soc->clock, "PWM_%s%d written while the channel %s", reg,
                 channel->number, running ? "is off" : "runs");
    return false;
}

static bool sixteen(const vb_channel_t *channel, const char *reg, uint32_t value) {
    if (value <= 0xFFFF) {
        return true;
    }
    vb_violation(channel->pwm->soc->clock, "PWM_%s%d: %u does not fit in 16 bits", reg,
                 channel->number, (unsigned)value);
    return false;
}

static void write_mode(vb_channel_t *channel, uint32_t value) {
    vb_pwm_t *pwm = channel->pwm;
    char name[NAME_BYTES];
    (void)snprintf(name, sizeof name, "PWM_CMR%d", channel->number);
    if (!only_bits(pwm, name, value, 0xF | CPOL)) {
        return;
    }
    if ((value & 0xF) > CLKB) {
        vb_violation(pwm->soc->clock, "%s: reserved clock", name);
    } else if (state_is(channel, false, "CMR")) {
        channel->mode = value;
        tell(pwm);
    }
}

static vb_access_t write_channel(vb_channel_t *channel, uint32_t offset, uint32_t value) {
    switch (offset) {
    case CMR:
        write_mode(channel, value);
        return VB_DONE;
    case CDTY: /* the chip ignores it while the channel runs */
        if (state_is(channel, false, "CDTY") && sixteen(channel, "CDTY", value)) {
            channel->duty = value;
        }
        return VB_DONE;
    case CDTYUPD: /* from the next period on; the last one written counts */
        if (state_is(channel, true, "CDTYUPD") && sixteen(channel, "CDTYUPD", value)) {
            channel->duty_next = value;
        }
        return VB_DONE;
    case CPRD:
        if (state_is(channel, false, "CPRD") && sixteen(channel, "CPRD", value)) {
            channel->period = value;
        }
        return VB_DONE;
    case CPRDUPD:
        if (state_is(channel, true, "CPRDUPD") && sixteen(channel, "CPRDUPD", value)) {
            channel->period_next = value;
        }
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}

static vb_access_t read_channel(const vb_channel_t *channel, uint32_t offset, uint32_t *value) {
    switch (offset) {
    case CMR:
        *value = channel->mode;
        return VB_DONE;
    case CDTY:
        *value = channel->duty;
        return VB_DONE;
    case CPRD:
        *value = channel->period;
        return VB_DONE;
    case CCNT:
        *value = 0;
        if (channel->running) {
            *value = (uint32_t)((channel->pwm->soc->clock->now - channel->start) / channel->unit);
        }
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}

static vb_channel_t *channel_at(vb_pwm_t *pwm, uint32_t offset) {
    uint32_t number = (offset - CHANNELS_START) / CHANNEL_BYTES;
    return offset >= CHANNELS_START && number < VB_PWM_CHANNELS ? &pwm->channels[number] : NULL;
}

vb_access_t vb_pwm_read(vb_pwm_t *pwm, uint32_t offset, uint32_t *value) {
    const vb_channel_t *channel = channel_at(pwm, offset);
    if (channel != NULL) {
        return read_channel(channel, offset % CHANNEL_BYTES, value);
    }
    switch (offset) {
    case CLK:
        *value = pwm->clk;
        return VB_DONE;
    case SR:
        *value = running_channels(pwm);
        return VB_DONE;
    case IMR1:
        *value = pwm->mask;
        return VB_DONE;
    case ISR1:
        *value = pwm->flags;
        pwm->flags = 0;
        drive(pwm);
        return VB_DONE;
    case SCM:
        *value = pwm->scm;
        return VB_DONE;
    case OOV:
        *value = pwm->output_values;
        return VB_DONE;
    case OS:
        *value = pwm->override;
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}

static void write_next(vb_pwm_t *pwm, bool set, uint32_t value) {
    if (only_bits(pwm, set ? "PWM_OSSUPD" : "PWM_OSCUPD", value, OUTPUTS)) {
        pwm->set_next = set ? pwm->set_next | value : pwm->set_next & ~value;
        pwm->clear_next = set ? pwm->clear_next & ~value : pwm->clear_next | value;
    }
}

static vb_access_t write_outputs(vb_pwm_t *pwm, uint32_t offset, uint32_t value) {
    switch (offset) {
    case OOV:
        if (only_bits(pwm, "PWM_OOV", value, OUTPUTS)) {
            pwm->output_values = value;
            tell(pwm);
        }
        return VB_DONE;
    case OS:
        write_override(pwm, value);
        return VB_DONE;
    case OSS:
        write_override(pwm, pwm->override | value);
        return VB_DONE;
    case OSC:
        write_override(pwm, pwm->override & ~value);
        return VB_DONE;
    case OSSUPD:
    case OSCUPD:
        write_next(pwm, offset == OSSUPD, value);
        return VB_DONE;
    default:
        return VB_UNKNOWN;
    }
}

vb_access_t vb_pwm_write(vb_pwm_t *pwm, uint32_t offset, uint32_t value) {
    vb_channel_t *channel = channel_at(pwm, offset);
    if (channel != NULL) {
        return write_channel(channel, offset % CHANNEL_BYTES, value);
    }
    switch (offset) {
    case CLK:
        write_clk(pwm, value);
        return VB_DONE;
    case ENA:
        write_ena(pwm, value);
        return VB_DONE;
    case DIS:
        write_dis(pwm, value);
        return VB_DONE;
    case IER1:
        if (only_bits(pwm, "PWM_IER1", value, 0xFF)) {
            pwm->mask |= value;
            drive(pwm);
        }
        return VB_DONE;
    case IDR1:
        pwm->mask &= ~value;
        drive(pwm);
        return VB_DONE;
    case SCM: /* synchronous channels are not modelled */
        (void)only_bits(pwm, "PWM_SCM", value, 0);
        return VB_DONE;
    default:
        return write_outputs(pwm, offset, value);
    }
}
