/* PWM controller: eight left-aligned channels, duty and period taken over at the period's end; as
 * vboard/periph/pwm.py. */
#ifndef VBOARD_PWM_H
#define VBOARD_PWM_H

#include "soc.h"

#define VB_PWM_CHANNELS 8

typedef struct vb_pwm vb_pwm_t;

typedef struct {
    vb_pwm_t *pwm;
    int number;
    int slot;
    bool running, stopping;
    int64_t start;                  /* of the present period */
    int64_t unit;                   /* clock ticks per count */
    int64_t duty_next, period_next; /* VB_NEVER: none */
    uint32_t mode, duty, period;
} vb_channel_t;

struct vb_pwm {
    vb_soc_t *soc;
    vb_channel_t channels[VB_PWM_CHANNELS];
    uint32_t clk, flags, mask, scm;
    uint32_t output_values, override; /* OOV, OS */
    uint32_t set_next, clear_next;
};

void vb_pwm_init(vb_pwm_t *pwm, vb_soc_t *soc);
void vb_pwm_reset(vb_pwm_t *pwm);

/* The master clock jumped (crystal failure): running channels go on at the new rate. */
void vb_pwm_retime(vb_pwm_t *pwm);

/* Fails while a channel counts; |what| happened. */
bool vb_pwm_refuse_if_running(vb_pwm_t *pwm, const char *what);

/* Level of PWML, or of PWMH with |high|, now; |turn|: when it changes within this period, or
 * VB_NEVER. */
bool vb_pwm_waveform(const vb_pwm_t *pwm, int channel, bool high, int64_t *turn);

/* High time of that output in the present period, in counts of the channel's clock. */
int64_t vb_pwm_high_counts(const vb_pwm_t *pwm, int channel, bool high);

bool vb_pwm_running(const vb_pwm_t *pwm, int channel);

/* The registers, in pwm_registers.c. VB_UNKNOWN: there is none to be accessed like that. */
vb_access_t vb_pwm_read(vb_pwm_t *pwm, uint32_t offset, uint32_t *value);
vb_access_t vb_pwm_write(vb_pwm_t *pwm, uint32_t offset, uint32_t value);

/* Between the two files. */

/* Starts a channel with a whole period, unless it runs; false after a failure. */
bool vb_pwm_start(vb_channel_t *channel);

/* Drives the interrupt. */
void vb_pwm_drive(vb_pwm_t *pwm);

/* Something may move an output at another time than waveform() told. */
void vb_pwm_tell(const vb_pwm_t *pwm);

#endif
