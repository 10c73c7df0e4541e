/*
 * The voltage at the middle of the battery's divider: one conversion per tick, started in one and
 * read in the next, so that nobody waits. The mean over five of them, 100 ms, goes out.
 */
#include "board.h"
#include "pins.h"
#include "registers/adc.h"

#define CHANNEL ADC_CHANNEL(BATTERY_ADC_CHANNEL)

/* Well between the converter's 1 and 20 MHz; the divider's source resistance is 6.7 kOhm. */
#define ADC_CLOCK_HZ 2000000u
#define STARTUP_512_CLOCKS 8u
#define TRACK_16_CLOCKS 15u
#define TRANSFER_AS_PRESCRIBED 1u

/* The first conversion waits for the converter to wake up: 0.3 ms. A pass takes more than a cycle.
 */
#define FIRST_CONVERSION_PASSES 84000u

#define COUNTS_FULL_SCALE 4096u

_Static_assert(HAL_BATTERY_SCALE % COUNTS_FULL_SCALE == 0, "whole steps per count");

static bool conversion_ended(void) { return (ADC->ISR & CHANNEL) != 0; }

static uint16_t last_conversion(void) {
    return (uint16_t)(ADC->CDR[BATTERY_ADC_CHANNEL] & ADC_CDR_DATA);
}

static void start_converter(uint32_t mck_hz) {
    ADC->CR = ADC_CR_SWRST;
    ADC->MR = FIELD(ADC_MR_PRESCAL, mck_hz / (2u * ADC_CLOCK_HZ) - 1u) |
              FIELD(ADC_MR_STARTUP, STARTUP_512_CLOCKS) | FIELD(ADC_MR_TRACKTIM, TRACK_16_CLOCKS) |
              FIELD(ADC_MR_TRANSFER, TRANSFER_AS_PRESCRIBED);
    ADC->CHER = CHANNEL;
    ADC->CR = ADC_CR_START;
}

/* All samples begin as the first, so that the voltage is right from the first question on. */
void battery_init(hal_t *hal) {
    pin_pull_up_off(PIN_BATTERY);
    clock_enable(ID_ADC);
    start_converter(hal->clocks.mck_hz);
    uint32_t passes = FIRST_CONVERSION_PASSES;
    while (!conversion_ended() && passes > 0) {
        passes--;
    }
    const uint16_t sample = last_conversion();
    for (uint32_t i = 0; i < BATTERY_SAMPLES; i++) {
        hal->battery_samples[i] = sample;
    }
    hal->battery_sum = (uint32_t)sample * BATTERY_SAMPLES;
    ADC->CR = ADC_CR_START;
}

static void replace_oldest(hal_t *hal, uint16_t sample) {
    uint16_t *oldest = &hal->battery_samples[hal->battery_at];
    hal->battery_sum = hal->battery_sum + sample - *oldest;
    *oldest = sample;
    hal->battery_at = (uint8_t)((hal->battery_at + 1u) % BATTERY_SAMPLES);
}

/* A conversion takes 20 us. A converter that has not done it within a frame is broken and counts as
 * an empty battery, not as the last good one. */
void battery_tick_isr(hal_t *hal) {
    replace_oldest(hal, conversion_ended() ? last_conversion() : 0);
    ADC->CR = ADC_CR_START;
}

uint16_t hal_battery_reading(const hal_t *hal) {
    const uint32_t steps = hal->battery_sum * (HAL_BATTERY_SCALE / COUNTS_FULL_SCALE);
    return (uint16_t)((steps + BATTERY_SAMPLES / 2u) / BATTERY_SAMPLES);
}
