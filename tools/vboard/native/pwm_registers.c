#include "pwm.h"

#include <stdio.h>

#define OUTPUTS 0x00FF00FFu /* OOV and friends: PWMH in [7:0], PWML in [23:16] */
#define CLKB 0xCu
#define CHANNELS_START 0x200u
#define CHANNEL_BYTES 0x20u
#define NAME_BYTES 24
#define CPOL (1u << 9)

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

/* Registers of all channels. */

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

static void write_ena(vb_pwm_t *pwm, uint32_t value) {
    if (!only_bits(pwm, "PWM_ENA", value, 0xFF)) {
        return;
    }
    for (int i = 0; i < VB_PWM_CHANNELS; i++) {
        if (value >> i & 1 && !vb_pwm_start(&pwm->channels[i])) {
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
        vb_pwm_tell(pwm);
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
        vb_pwm_tell(pwm);
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
        vb_pwm_drive(pwm);
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
            vb_pwm_tell(pwm);
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
            vb_pwm_drive(pwm);
        }
        return VB_DONE;
    case IDR1:
        pwm->mask &= ~value;
        vb_pwm_drive(pwm);
        return VB_DONE;
    case SCM: /* synchronous channels are not modelled */
        (void)only_bits(pwm, "PWM_SCM", value, 0);
        return VB_DONE;
    default:
        return write_outputs(pwm, offset, value);
    }
}
