/*
 * Which pin does what. docs/how-to/wiring.md holds the same table; a test compares the two.
 *
 * After a reset every pin is an input with its pull-up on.
 */
#ifndef SAM3X8E_PINS_H
#define SAM3X8E_PINS_H

#include <stdbool.h>

/* PIN(name, port, bit, peripheral A, B or NONE (plain or analogue), Due header, signal) */
#define SAM3X8E_PINS(PIN)                                                                          \
    PIN(SERVO, C, 21, B, "D9", "PWML4")                                                            \
    PIN(IMU_RX, A, 10, A, "D19", "RXD0")                                                           \
    PIN(IMU_TX, A, 11, A, "D18", "TXD0")                                                           \
    PIN(RADIO_RX, A, 12, A, "D17", "RXD1")                                                         \
    PIN(RADIO_TX, A, 13, A, "D16", "TXD1")                                                         \
    PIN(CONSOLE_RX, A, 8, A, "D0", "URXD")                                                         \
    PIN(CONSOLE_TX, A, 9, A, "D1", "UTXD")                                                         \
    PIN(BATTERY, A, 16, NONE, "A0", "AD7")                                                         \
    PIN(LED, B, 27, NONE, "D13", "PB27")

/* ROW(name in hal_servo_t, pin, channel of the PWM controller whose output L it is); a line per
 * row. */
/* clang-format off */
#define SAM3X8E_SERVOS(ROW) \
    ROW(TAIL, SERVO, 4)
/* clang-format on */

#define BATTERY_ADC_CHANNEL 7u

#define SAM3X8E_PIN_NAME(name, port, bit, peripheral, header, signal) PIN_##name,
typedef enum { SAM3X8E_PINS(SAM3X8E_PIN_NAME) PIN_COUNT } pin_t;
#undef SAM3X8E_PIN_NAME

/* All of these: any context, a few cycles, no clock needed. */

/* Makes the pin a plain output at |level| and takes its pull-up off. It never shows the other level
 * on the way. */
void pin_output(pin_t pin, bool level);

/* Changes the level of a plain output. */
void pin_set(pin_t pin, bool level);

/* Hands the pin to the peripheral of the table; its pull-up stays as it is. */
void pin_to_peripheral(pin_t pin);

void pin_pull_up_off(pin_t pin);

#endif
