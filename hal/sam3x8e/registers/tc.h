/* Timer counters, 32 bits wide: of block 0 channel 0 is the time base, channel 1 sees to the tick.
 */
#ifndef REGISTERS_TC_H
#define REGISTERS_TC_H

#include "registers/field.h"

typedef struct {
    uint32_t CCR;
    uint32_t CMR;
    uint32_t SMMR;
    uint32_t reserved_00c;
    const uint32_t CV;
    uint32_t RA;
    uint32_t RB;
    uint32_t RC;
    const uint32_t SR;
    uint32_t IER;
    uint32_t IDR;
    const uint32_t IMR;
    uint32_t reserved_030[4];
} tc_channel_registers_t;

typedef struct {
    tc_channel_registers_t CHANNEL[3];
} tc_registers_t;

REGISTER_AT(tc_channel_registers_t, IMR, 0x2C);
REGISTER_AT(tc_registers_t, CHANNEL[1], 0x40);

#define TC0 ((volatile tc_registers_t *)0x40080000u)

#define TC_CCR_CLKEN 0x00000001u
#define TC_CCR_CLKDIS 0x00000002u
#define TC_CCR_SWTRG 0x00000004u

#define TC_CMR_TCCLKS 0x00000007u
#define TC_CMR_TCCLKS_TIMER_CLOCK1 FIELD(TC_CMR_TCCLKS, 0)
#define TC_CMR_TCCLKS_TIMER_CLOCK4 FIELD(TC_CMR_TCCLKS, 3) /* MCK / 128 */
#define TC_CMR_WAVE 0x00008000u

#define TC_IER_CPCS 0x00000010u /* the count is RC's */

#endif
