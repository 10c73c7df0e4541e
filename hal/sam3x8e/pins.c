#include "pins.h"

#include "registers/pio.h"

typedef enum { PERIPHERAL_NONE, PERIPHERAL_A, PERIPHERAL_B } peripheral_t;

typedef struct {
    volatile pio_registers_t *pio;
    uint32_t mask;
    peripheral_t peripheral;
} pin_place_t;

#define PLACE(name, port, bit, peripheral, header, signal)                                         \
    [PIN_##name] = {PIO##port, 1u << (bit), PERIPHERAL_##peripheral},
static const pin_place_t places[PIN_COUNT] = {SAM3X8E_PINS(PLACE)};

void pin_set(pin_t pin, bool level) {
    const pin_place_t *place = &places[pin];
    if (level) {
        place->pio->SODR = place->mask;
    } else {
        place->pio->CODR = place->mask;
    }
}

void pin_output(pin_t pin, bool level) {
    const pin_place_t *place = &places[pin];
    pin_set(pin, level);
    place->pio->OER = place->mask;
    place->pio->PER = place->mask;
    place->pio->PUDR = place->mask;
}

void pin_to_peripheral(pin_t pin) {
    const pin_place_t *place = &places[pin];
    if (place->peripheral == PERIPHERAL_B) {
        place->pio->ABSR |= place->mask;
    } else {
        place->pio->ABSR &= ~place->mask;
    }
    place->pio->PDR = place->mask;
}

void pin_pull_up_off(pin_t pin) { places[pin].pio->PUDR = places[pin].mask; }
